"""The page on which one walks through a map: for its members, and as the first page of visitors."""

import io
import json
import re
import zipfile

import pytest
from sqlalchemy import update

from tests.web.sharing.stripes import BOX, blur, contrast, fetched, stripes
from webapp.store.schema import Photo


def data_of(page, name):
    """Return the JSON that a page has for its scripts."""
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.S)
    return json.loads(found[1])


@pytest.fixture
def walked(client, full):
    """A map with four photos along a line, of which the last is in the tray; the second looks east."""
    for n in range(1, 4):
        file = (io.BytesIO(stripes() + bytes([n])), f"{n}.jpg")
        assert client.post(f"/api/v1/maps/{full}/photos", data={"file": [file]}).json[0]["id"] == n
    changes = [{"id": n, "x_px": 50.0 + 20 * n, "y_px": 60.0, "heading_deg": 90.0} for n in (1, 2)]
    assert client.patch(f"/api/v1/maps/{full}/experiences", json={"changes": changes}).status_code == 200
    return full


@pytest.fixture
def share(client, walked):
    """Share the map and return the end of its address."""

    def make(**allows):
        made = client.post(f"/api/v1/maps/{walked}/shares", json=allows)
        assert made.status_code == 201
        return made.json["url"].rsplit("/", 1)[1]

    return make


def test_the_walk_has_the_placed_photos_and_their_directions(client, walked):
    walk = data_of(client.get(f"/maps/{walked}/view").text, "walk")
    assert sorted(walk["by_place"]) == [0, 1, 2]
    steps = {id: bearing for id, bearing, _ in walk["steps"]["1"]}
    assert steps[2] == pytest.approx(90, abs=1)
    assert steps[0] == pytest.approx(270, abs=1)


def test_a_map_without_placed_photos_leads_to_the_editor(client, park):
    page = client.get(f"/maps/{park}/view").text
    assert f"/maps/{park}/edit" in page
    assert 'id="photo-frame"' not in page


def test_visitors_begin_with_it_if_the_share_has_pictures(stranger, share):
    token = share(photos=True)
    assert sorted(data_of(stranger.get(f"/s/{token}").text, "walk")["by_place"]) == [0, 1, 2]
    assert 'id="photo-frame"' not in stranger.get(f"/s/{token}/map").text
    assert 'id="photo-frame"' not in stranger.get(f"/s/{share()}").text


def test_it_leads_visitors_to_localize_only_where_they_may(stranger, share):
    assert "find-mine" not in stranger.get(f"/s/{share(photos=True)}").text
    assert "find-mine" in stranger.get(f"/s/{share(photos=True, localize=True)}").text


def test_what_is_blurred_stays_blurred_for_visitors(client, stranger, share, walked):
    blur(client, walked, BOX)
    state = data_of(stranger.get(f"/s/{share(photos=True, originals=True)}").text, "state")
    photo = next(photo for photo in state["photos"] if photo["id"] == 0)
    assert photo["original"] is None
    for kind in ("preview", "thumb"):
        assert contrast(fetched(stranger, photo[kind])) < 20


@pytest.mark.parametrize(("originals", "seen"), [(False, None), (True, "Leica M3")])
def test_visitors_see_cameras_only_with_originals(stranger, share, library, originals, seen):
    with library.database.write() as session:
        session.execute(update(Photo).values(camera="Leica M3"))
    state = data_of(stranger.get(f"/s/{share(photos=True, originals=originals)}").text, "state")
    assert {photo["camera"] for photo in state["photos"]} == {seen}


@pytest.mark.parametrize(("originals", "seen"), [(False, []), (True, [2, 1, 0])])
def test_visitors_see_in_which_order_photos_were_taken_only_with_originals(
    client, stranger, share, walked, library, originals, seen
):
    with library.database.write() as session:
        for id in range(3):
            taken = f"2024-05-01T1{2 - id}:00:00"
            session.execute(update(Photo).where(Photo.id == id).values(taken_at=taken))
    page = stranger.get(f"/s/{share(photos=True, originals=originals)}").text
    assert data_of(page, "walk")["by_time"] == seen
    assert [photo["id"] for photo in data_of(page, "state")["photos"]] == [0, 1, 2]
    assert data_of(client.get(f"/maps/{walked}/view").text, "walk")["by_time"] == [2, 1, 0]


def test_the_owner_says_what_the_map_is(client, stranger, share, walked):
    said = {"name": "Park", "description": " The park \n in May.  "}
    assert client.post(f"/maps/{walked}/settings/name", data=said).status_code == 303
    assert "The park in May." in client.get(f"/maps/{walked}/view").text
    assert "The park in May." in stranger.get(f"/s/{share(photos=True)}").text
    assert '<p class="small grow">The park in May.</p>' in stranger.get(f"/s/{share(photos=True)}/map").text
    assert client.get(f"/api/v1/maps/{walked}").json["description"] == "The park in May."
    with zipfile.ZipFile(io.BytesIO(client.get(f"/api/v1/maps/{walked}/export.zip").data)) as exported:
        (name,) = (one for one in exported.namelist() if one.endswith("map.json"))
        assert json.loads(exported.read(name))["description"] == "The park in May."
    revision = client.get(f"/api/v1/maps/{walked}").json["revision"]
    for sent, kept, revisions in (
        ({"name": "Park"}, "The park in May.", 0),
        (said, "The park in May.", 0),
        ({"name": "Wood", "description": "Ash."}, "Ash.", 1),
        ({"name": "Wood", "description": ""}, None, 2),
    ):
        assert client.post(f"/maps/{walked}/settings/name", data=sent).status_code == 303
        state = client.get(f"/api/v1/maps/{walked}").json
        assert (state["description"], state["revision"]) == (kept, revision + revisions)


def test_a_description_that_is_too_long_is_refused(client, walked):
    said = {"name": "Park", "description": "x" * 301}
    assert client.post(f"/maps/{walked}/settings/name", data=said).status_code == 400
    assert client.get(f"/api/v1/maps/{walked}").json["description"] is None


def test_the_timeline_lists_the_days_of_all_maps_that_one_may_see(
    client, sign_in, new_account, walked, library
):
    times = {
        0: "2024-05-01T10:00:00",
        1: "2024-05-02T10:00:00",
        2: "2024-05-02T09:00:00",
        3: "2023-01-01T09:00:00",
    }
    with library.database.write() as session:
        for id, time in times.items():
            session.execute(update(Photo).where(Photo.id == id).values(taken_at=time))
    page = client.get("/timeline").text
    assert re.findall(r'id="day-(.*?)"', page) == ["2024-05-02", "2024-05-01"]
    assert re.findall(r'<li><a href="(.*?)"', page) == [f"/maps/{walked}/view?photo={id}" for id in (2, 1, 0)]
    assert re.findall(r'id="day-(.*?)"', client.get("/timeline?before=2024-05-02").text) == ["2024-05-01"]
    assert client.get("/timeline?before=then").status_code == 400
    other = sign_in(new_account("Eve")).get("/timeline").text
    assert "day-" not in other
    assert "without-time" not in page + other


def test_the_timeline_says_how_many_photos_it_leaves_out(client, sign_in, new_account, walked, library):
    with library.database.write() as session:
        session.execute(update(Photo).where(Photo.id == 1).values(taken_at="2024-05-02T10:00:00"))
        session.execute(update(Photo).where(Photo.id != 1).values(taken_at=None))
    assert "2 placed photos have no time" in client.get("/timeline").text
    assert "without-time" not in sign_in(new_account("Eve")).get("/timeline").text
