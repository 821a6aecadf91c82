"""Phones send positions to a mission by links of their own."""

import base64
import json

import pytest

from webapp.missions.store import phones
from webapp.missions.store.schema import MissionPhone, MissionSender

POSITION = {"time": 1777629600.0, "lat": 50.1, "lon": 14.4, "accuracy_m": 8.0}
OWNTRACKS = {"_type": "location", "lat": 50.1, "lon": 14.4, "tst": 1777629600, "acc": 12, "batt": 81}


@pytest.fixture
def mission(client):
    return client.post("/api/v1/missions", json={"name": "Search"}).json["id"]


@pytest.fixture
def add(client, mission):
    def add(name="Anna"):
        answer = client.post(f"/api/v1/missions/{mission}/phones", json={"name": name})
        assert answer.status_code == 201, answer.text
        return answer.json

    return add


def path(phone, rest=""):
    return f"/api/v1/phones/{phone['url'].rpartition('/')[2]}/{rest}"


def tracks(client, mission):
    return {one["name"]: one["poses"] for one in client.get(f"/api/v1/missions/{mission}").json["tracks"]}


def send(stranger, phone, first, count, *, sender="a" * 32):
    positions = [POSITION | {"time": POSITION["time"] + n} for n in range(first, first + count)]
    sent = {"sender": sender, "first": first, "positions": positions}
    return stranger.post(path(phone, "positions"), json=sent)


def test_positions_become_a_track_named_like_the_phone(client, stranger, mission, add):
    phone = add()
    assert send(stranger, phone, 0, 3).json["next"] == 3
    assert tracks(client, mission) == {"Anna": 3}
    (listed,) = client.get(f"/api/v1/missions/{mission}/phones").json["phones"]
    assert (listed["name"], listed["positions"]) == ("Anna", 3) and listed["heard_at"]
    assert "url" not in listed


def test_positions_sent_again_are_stored_once_and_a_gap_is_refused(client, stranger, mission, add):
    phone = add()
    send(stranger, phone, 0, 3)
    assert send(stranger, phone, 1, 4).json["stored"] == 2
    gap = send(stranger, phone, 9, 1)
    assert (gap.status_code, gap.json["error"]["next"]) == (409, 5)
    assert tracks(client, mission) == {"Anna": 5}


def test_two_phones_do_not_share_their_numbers(client, stranger, mission, add):
    one, other = add(), add("Boris")
    send(stranger, one, 0, 2)
    send(stranger, other, 0, 3)
    assert tracks(client, mission) == {"Anna": 2, "Boris": 3}


def test_owntracks_and_other_apps(client, stranger, mission, add):
    phone = add()
    for _ in range(2):  # an app that got no answer sends again
        answer = stranger.post(path(phone, "owntracks"), json=OWNTRACKS)
        assert (answer.status_code, answer.json) == (200, [])
    assert stranger.post(path(phone, "owntracks"), json={"_type": "lwt", "tst": 1}).json == []
    query = {"lat": 50.2, "lon": 14.4, "time": "2026-05-01T10:01:00Z", "acc": 5}
    assert stranger.get(path(phone, "track"), query_string=query).status_code == 204
    assert stranger.post(path(phone, "track"), data=query | {"time": 1777629720}).status_code == 204
    assert tracks(client, mission) == {"Anna": 3}
    (listed,) = client.get(f"/api/v1/missions/{mission}/phones").json["phones"]
    assert listed["positions"] == 3
    (robot,) = client.get(f"/api/v1/missions/{mission}/robots").json["robots"]
    assert (robot["name"], robot["status"]["battery_percent"]) == ("Anna", 81.0)


@pytest.mark.parametrize(
    ("rest", "sent"),
    [
        ("positions", {"sender": "a" * 32, "first": 0, "positions": [POSITION | {"lat": 91}]}),
        ("positions", {"sender": "a" * 32, "first": 0, "positions": [POSITION] * 501}),
        ("positions", {"sender": "a", "first": 0, "positions": []}),
        ("owntracks", OWNTRACKS | {"lat": "north"}),
        ("owntracks", {"_type": "encrypted", "data": ""}),
        ("owntracks", {}),
        ("owntracks", []),
        ("track", None),
    ],
)
def test_what_cannot_be_read_is_refused(client, stranger, mission, add, rest, sent):
    answer = stranger.post(path(add(), rest), json=sent)
    assert 400 <= answer.status_code < 500 and answer.json["error"]["message"]
    assert tracks(client, mission) == {}


def test_a_link_that_was_removed_stores_nothing_and_its_track_stays(client, stranger, mission, add):
    phone = add()
    send(stranger, phone, 0, 1)
    assert client.delete(f"/api/v1/missions/{mission}/phones/{phone['id']}").status_code == 204
    assert send(stranger, phone, 1, 1).status_code == 404
    assert stranger.get(phone["url"]).status_code == 404
    assert tracks(client, mission) == {"Anna": 1}
    again = client.delete(f"/api/v1/missions/{mission}/phones/{phone['id']}")
    assert again.status_code == 404


def test_in_the_bin_nothing_is_stored(client, stranger, mission, add):
    phone = add()
    client.delete(f"/api/v1/missions/{mission}")
    assert send(stranger, phone, 0, 1).status_code == 404


def test_only_a_hash_of_the_link_is_kept(library, add):
    phone = add()
    with library.database.read() as session:
        (kept,) = session.query(MissionPhone)
    assert kept.token_hash not in phone["url"]


def test_a_link_cannot_fill_the_disk(library, stranger, mission, add, monkeypatch):
    monkeypatch.setattr(phones, "MOST_POSITIONS", 4)
    phone = add()
    assert send(stranger, phone, 0, 3).status_code == 200
    refused = send(stranger, phone, 3, 2)
    assert refused.status_code == 409 and "link" in refused.json["error"]["message"]
    with library.database.read() as session:
        (sender,) = session.query(MissionSender)
        assert sender.next_seq == 3  # nothing of the refused batch


def test_names_of_phones_are_unique_and_valid(client, mission, add):
    add()
    for name, status in (("anna ", 409), ("", 400), ("\n", 400), ("x" * 61, 400)):
        answer = client.post(f"/api/v1/missions/{mission}/phones", json={"name": name})
        assert answer.status_code == status, (name, answer.text)


def test_strangers_cannot_add_phones(mission, stranger):
    for method in ("get", "post"):
        assert (
            getattr(stranger, method)(f"/api/v1/missions/{mission}/phones", json={"name": "A"}).status_code
            == 401
        )


def test_addresses_of_a_new_phone(add):
    phone = add()
    setup = phone["owntracks_setup"].partition("inline=")[2]
    assert json.loads(base64.b64decode(setup)) == {
        "_type": "configuration",
        "mode": 3,
        "url": phone["owntracks"],
    }
    assert phone["qr"]["size"] > 29 and phone["qr"]["path"].startswith("M4 4h1v1h-1z")


def test_the_page_of_a_phone(stranger, add):
    page = stranger.get(add("Anna & Jo")["url"])
    assert page.status_code == 200 and "noindex" in page.headers["X-Robots-Tag"]
    assert "Anna &amp; Jo" in page.text and "Search" in page.text
