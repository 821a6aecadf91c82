"""Visitors give photos to a shared map: what is agreed, limited, suggested, accepted, refused and undone."""

import io
from dataclasses import replace

import pytest
from PIL import Image

from webapp.errors import NotReady
from webapp.settings import ContributionSettings
from webapp.store import contributions
from webapp.store.schema import Contribution, Share
from webapp.tasks.localize import upload

PLACE = {"x_px": 12.0, "y_px": 34.0, "radius_px": 5.0, "heading_deg": 90.0, "probability": 0.8}
FORM = {"hypotheses": [{**PLACE, "experiences": [0]}], "off_map_probability": 0.1}


def jpeg(number=0, size=(64, 48)):
    file = io.BytesIO()
    Image.new("RGB", size, (number % 256, 30, 60)).save(file, "JPEG")
    return file.getvalue()


@pytest.fixture
def found(monkeypatch):
    """What localization answers to visitors."""
    answer = dict(FORM)

    class Result:
        form = answer

    monkeypatch.setattr(upload, "localize_uploads", lambda *_, **__: Result)
    monkeypatch.setattr("webapp.web.sharing.api_contributions.map_cache", lambda: None)
    return answer


@pytest.fixture
def share(client, full):
    answer = client.post(f"/api/v1/maps/{full}/shares", json={"contribute": True})
    assert (answer.status_code, answer.json["contribute"]) == (201, True)
    return answer.json


@pytest.fixture
def give(stranger, share):
    """Send a photo as a visitor."""
    token = share["url"].rpartition("/")[2]

    def send(data=None, *, status=201, name="v.jpg", **form):
        body = {"file": (io.BytesIO(jpeg() if data is None else data), name), "consent": "true", **form}
        answer = stranger.post(f"/api/v1/shared/{token}/contributions", data=body)
        assert answer.status_code == status, answer.text
        return answer.json

    return send


def waiting(client, slug):
    return client.get(f"/api/v1/maps/{slug}/contributions").json


def photo_of(client, slug, id):
    return next((one for one in client.get(f"/api/v1/maps/{slug}").json["photos"] if one["id"] == id), None)


def test_a_photo_waits_with_its_place_and_is_accepted_with_one_edit_that_is_undone(client, full, give, found):
    before = len(client.get(f"/api/v1/maps/{full}").json["photos"])
    assert give() == {"found": True, "searching": False, "x_px": 12.0, "y_px": 34.0}
    (one,) = waiting(client, full)["photos"]
    assert (one["x_px"], one["heading_deg"], one["probability"], one["name"]) == (12.0, 90.0, 0.8, "v.jpg")
    for name in ("thumb", "preview"):
        with client.get(one[name]) as picture:
            assert picture.status_code == 200
    assert photo_of(client, full, one["id"])["x_px"] is None
    accept = f"/api/v1/maps/{full}/contributions/{one['id']}/accept"
    assert client.post(accept).json == {"photos": [], "waiting": 0}
    placed = photo_of(client, full, one["id"])
    assert [placed[name] for name in ("x_px", "y_px", "radius_px", "heading_deg")] == [12.0, 34.0, 5.0, 90.0]
    assert client.post(accept).status_code == 404
    assert client.post(f"/api/v1/maps/{full}/undo").status_code == 200
    assert [photo["id"] for photo in waiting(client, full)["photos"]] == [one["id"]]
    assert client.delete(f"/api/v1/maps/{full}/experiences/{one['id']}").status_code == 200
    assert waiting(client, full) == {"photos": [], "waiting": 0}
    assert client.post(f"/api/v1/maps/{full}/undo").status_code == 200
    assert waiting(client, full)["waiting"] == 1
    assert len(client.get(f"/api/v1/maps/{full}").json["photos"]) == before + 1


def test_visitors_do_not_see_what_waits(client, stranger, full, share, give, found):
    token = share["url"].rpartition("/")[2]
    seen = [one["id"] for one in stranger.get(f"/api/v1/shared/{token}").json["photos"]]
    give()
    assert [one["id"] for one in stranger.get(f"/api/v1/shared/{token}").json["photos"]] == seen
    assert stranger.get(f"/api/v1/maps/{full}/contributions").status_code == 401


def test_a_photo_that_is_not_found_waits_without_a_place(client, full, give, found, monkeypatch):
    found["off_map_probability"] = 0.9
    assert give()["found"] is False

    def not_ready(*_, **__):
        raise NotReady("the index is being made")

    monkeypatch.setattr(upload, "localize_uploads", not_ready)
    assert give(jpeg(1))["found"] is False
    photos = waiting(client, full)["photos"]
    assert [one["x_px"] for one in photos] == [None, None]
    answer = client.post(f"/api/v1/maps/{full}/contributions/{photos[0]['id']}/accept")
    assert (answer.status_code, answer.json["error"]["hint"]) == (400, "place it in the editor")


def test_without_consent_or_permission_nothing_is_kept(client, full, give, found, share, library):
    assert "agree" in give(status=400, consent="false")["error"]["hint"]
    give(status=422, consent="maybe")
    client.patch(f"/api/v1/maps/{full}/shares/{share['id']}", json={"contribute": False})
    give(status=404)
    client.delete(f"/api/v1/maps/{full}/shares/{share['id']}")
    give(status=404)
    assert waiting(client, full)["waiting"] == 0
    assert [*library.uploads.glob("*")] == []


def test_the_same_photo_is_taken_once_also_after_it_was_refused(client, full, give, found):
    give()
    assert "before" in give(status=409)["error"]["message"]
    (one,) = waiting(client, full)["photos"]
    client.delete(f"/api/v1/maps/{full}/experiences/{one['id']}")
    give(status=409)
    assert waiting(client, full)["waiting"] == 0


def test_what_is_no_photo_is_refused(client, full, give, found, library):
    give(b"no photo", status=422)
    give(jpeg()[:300], status=422)
    assert (waiting(client, full)["waiting"], [*library.uploads.glob("*")]) == (0, [])


@pytest.mark.parametrize(
    ("limits", "message", "status"),
    [
        (ContributionSettings(max_mb=1e-4), "more than", 400),
        (ContributionSettings(photos_per_day=1), "today", 429),
        (ContributionSettings(mb_per_day=1e-3), "today", 429),
        (ContributionSettings(waiting_photos=1), "wait for the owners", 429),
        (ContributionSettings(waiting_mb=1e-3), "wait for the owners", 429),
    ],
)
def test_what_visitors_give_is_limited(app, client, full, give, found, limits, message, status):
    give()
    held = app.extensions["expmap"]
    app.extensions["expmap"] = replace(held, settings=replace(held.settings, contributions=limits))
    answer = give(jpeg(1), status=status)
    assert message in answer["error"]["message"]
    assert waiting(client, full)["waiting"] == 1


def test_only_who_can_edit_decides(client, full, give, found, new_account, sign_in):
    give()
    eva = new_account("Eva")
    client.post(f"/api/v1/maps/{full}/members", json={"name": "Eva", "role": "viewer"})
    browser = sign_in(eva)
    assert browser.get(f"/api/v1/maps/{full}/contributions").status_code == 403
    assert "Only people who can edit" in browser.get(f"/maps/{full}/contributions").text
    assert 'id="photos"' in client.get(f"/maps/{full}/contributions").text


def test_the_page_of_a_share_asks_for_photos_only_if_it_may(client, stranger, full, share):
    address = share["url"].partition("://")[2].partition("/")[2]
    page = stranger.get(f"/{address}/map").text
    assert "give-consent" in page and "nobody in them minds" in page
    client.patch(f"/api/v1/maps/{full}/shares/{share['id']}", json={"photos": True})
    assert "give-consent" not in stranger.get(f"/{address}/map").text
    answer = client.post(f"/api/v1/maps/{full}/shares", json={"contribute": True, "query": None})
    assert answer.json["contribute"] is True


def test_an_address_is_not_stored(client, full, give, found, library):
    give()
    with library.database.read() as session:
        (row,) = session.query(Contribution).all()
        share = session.get_one(Share, row.share_id)
        same = contributions.visitor_of(share, address="127.0.0.1", at=row.sent_at)
        other = contributions.visitor_of(share, address="127.0.0.2", at=row.sent_at)
    assert (row.visitor == same, other == same, "127" in row.visitor[:3]) == (True, False, False)
