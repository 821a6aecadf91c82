"""A query that is sent again with its key is localized once; shared answers are not deleted."""

import io
from types import SimpleNamespace

import pytest

from webapp.store import queries, sharing
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.schema import QueryRecord
from webapp.store.sharing import SharePermissions
from webapp.tasks.localize import upload
from webapp.tasks.localize.upload import LocalizeResult


@pytest.fixture
def asked(monkeypatch):
    """Names of the localized photos; each gets the answer "not on this map"."""
    names = []

    def run(_maps, _map_id, *, request):
        names.append(request.photos[0].name)
        form = {"query": names[-1], "hypotheses": [], "off_map_probability": 1.0, "other_probability": 0.0}
        form["seconds"] = {}
        return LocalizeResult(
            form, (), 0, SimpleNamespace(calibrated=True, not_indexed=0, to_calibrate=False)
        )

    monkeypatch.setattr(upload, "localize_uploads", run)
    return names


@pytest.fixture
def send(client, park, sample_folder):
    """Localize a photo, with a key."""
    photo = (sample_folder / "queries" / "query_02.jpg").read_bytes()

    def post(key=None, *, browser=client, **fields):
        headers = {} if key is None else {"Idempotency-Key": key}
        data = {"file": (io.BytesIO(photo), "a.jpg"), **fields}
        return browser.post(f"/api/v1/maps/{park}/localize", data=data, headers=headers)

    return post


def history(client, park):
    return [row["id"] for row in client.get(f"/api/v1/maps/{park}/queries").json["queries"]]


def test_the_same_key_gets_the_same_answer(client, park, send, asked):
    first, again, other = send("one"), send("one"), send("two")
    assert first.status_code == again.status_code == 200
    assert first.json["id"] == again.json["id"] != other.json["id"]
    assert again.json["off_map_probability"] == 1.0
    assert len(asked) == 2
    assert history(client, park) == [other.json["id"], first.json["id"]]


def test_without_a_key_each_one_is_a_new_question(client, park, send, asked):
    assert send().json["id"] != send().json["id"]
    assert len(history(client, park)) == 2


def test_keys_of_others_are_others(park, send, asked, sign_in, new_account, library, owner):
    ana = new_account("Ana")
    assert sign_in(ana).get(f"/api/v1/maps/{park}").status_code == 404
    with library.database.write() as session:
        record = maps.find(session, park, account=owner)
        accounts.set_member_role(session, record, account=ana, role="viewer")
    assert send("one").json["id"] != send("one", browser=sign_in(ana)).json["id"]


def test_what_is_not_kept_has_no_key(send, asked):
    assert send("one", keep="false").json["id"] is None
    assert send("one", keep="false").json["id"] is None
    assert len(asked) == 2


def test_a_key_that_is_too_long_is_refused(send, asked):
    assert send("x" * 101).status_code == 422
    assert asked == []


def test_two_at_the_same_time_leave_one_answer(client, park, send, asked, monkeypatch):
    first = send("one").json["id"]
    # The first check finds no answer, as when two requests arrive in parallel.
    monkeypatch.setattr(queries, "keyed", _blind_once(queries.keyed))
    assert send("one").json["id"] == first
    assert len(asked) == 2
    assert history(client, park) == [first]


def _blind_once(real):
    looks = []

    def keyed(*args, **kwargs):
        looks.append(1)
        return None if len(looks) == 1 else real(*args, **kwargs)

    return keyed


def test_shared_answers_are_not_forgotten(library, park, owner, send, asked):
    shared = send("one").json["id"]
    with library.database.write() as session:
        record = maps.find(session, park, account=owner)
        sharing.create(session, record, allows=SharePermissions(), account_id=owner.id, query_id=shared)
        unshared = row()
        queries.add(session, record, row=unshared, most=9)
        assert queries.add(session, record, row=row(), most=1) == [unshared]
        assert {q.id for q in queries.list_queries(session, record)} >= {shared}


def row():
    facts = {"options": {}, "answer": {"hypotheses": []}, "evidence": [], "width": 1, "height": 1}
    return QueryRecord(name="b.jpg", file="b.jpg", **facts)
