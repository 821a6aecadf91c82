"""Missions: created, changed, binned, deleted; permissions."""

import json
import re

import pytest

from webapp.errors import Cancelled
from webapp.missions.store.schema import Mission, ObjectSighting, Pose
from webapp.missions.tasks import delete as delete_mission
from webapp.progress import Progress


def test_a_new_mission(client, new_map, owner):
    slug = new_map(owner)
    start = {"lat": 50.1, "lon": 14.4}
    made = client.post(
        "/api/v1/missions", json={"name": " A  b ", "map": slug, "start": start, "note": "x\ny"}
    )
    assert made.status_code == 201
    found = client.get(f"/api/v1/missions/{made.json['id']}").json
    assert (found["name"], found["map"], found["note"]) == ("A b", slug, "x\ny")
    assert found["start"] == {"lat": 50.1, "lon": 14.4, "heading_deg": 90.0}
    assert found["url"] == f"/missions/{found['id']}"
    assert (found["tracks"], found["satellite"], found["revision"]) == ([], None, 0)


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ({"name": ""}, 400),
        ({"name": "x" * 121}, 400),
        ({"name": "\ud800"}, 400),
        ({"name": "x", "note": "\ud800"}, 400),
        ({"name": "x", "start": {"lat": 91, "lon": 0}}, 422),
        ({"name": "x", "map": "nowhere"}, 404),
        ({}, 422),
    ],
)
def test_no_mission(client, given, status):
    assert client.post("/api/v1/missions", json=given).status_code == status
    assert client.get("/api/v1/missions").json == {"missions": [], "next": None}


def test_changes(client, mission, state, new_map, owner):
    slug = new_map(owner)
    client.patch(f"/api/v1/missions/{mission}", json={"name": "New", "map": slug})
    assert (state()["name"], state()["map"], state()["revision"]) == ("New", slug, 1)
    client.patch(f"/api/v1/missions/{mission}", json={"map": None, "note": "n"})
    assert (state()["name"], state()["map"], state()["note"]) == ("New", None, "n")
    assert state()["keep"] is False
    client.patch(f"/api/v1/missions/{mission}", json={"keep": True})
    assert (state()["keep"], state()["note"]) == (True, "n")


def test_the_roles_of_the_map_hold(new_account, new_map, new_mission, sign_in, owner):
    people = {role: new_account(role) for role in ("viewer", "editor", "other")}
    shared = {people["viewer"]: "viewer", people["editor"]: "editor"}
    id = new_mission(map=new_map(owner, shared=shared))
    address = f"/api/v1/missions/{id}"
    expected = {"viewer": (200, 403, 403, 1), "editor": (200, 200, 403, 1), "other": (404, 404, 404, 0)}
    for role, (look, edit, delete, listed) in expected.items():
        browser = sign_in(people[role])
        assert browser.get(address).status_code == look
        assert browser.patch(address, json={"note": "a"}).status_code == edit
        assert browser.delete(address).status_code == delete
        assert len(browser.get("/api/v1/missions").json["missions"]) == listed


def test_a_mission_without_a_map_is_its_makers(client, new_account, new_mission, sign_in):
    ann, bob = sign_in(new_account("ann")), sign_in(new_account("bob"))
    id = new_mission(ann)
    assert [b.get(f"/api/v1/missions/{id}").status_code for b in (ann, bob, client)] == [200, 404, 200]
    assert bob.get("/api/v1/missions").json["missions"] == []


def test_only_editors_put_a_mission_on_a_map(new_account, new_map, new_mission, sign_in, owner):
    ann = new_account("ann")
    slug = new_map(owner, shared={ann: "viewer"})
    browser = sign_in(ann)
    assert browser.post("/api/v1/missions", json={"name": "x", "map": slug}).status_code == 403
    id = new_mission(browser)
    assert browser.patch(f"/api/v1/missions/{id}", json={"map": slug}).status_code == 403


def test_the_bin(client, mission, send, walk):
    send(walk(3))
    address = f"/api/v1/missions/{mission}"
    assert client.delete(f"{address}?forever=true").status_code == 409
    assert client.delete(address).json["binned"]
    assert client.get("/api/v1/missions").json["missions"] == []
    assert len(client.get("/api/v1/missions?bin=true").json["missions"]) == 1
    assert send(walk(1), first=3).status_code == 404
    assert not client.post(f"{address}/restore").json["binned"]
    assert send(walk(1, begin=3), first=3).json["stored"] == 1


def test_a_mission_with_links_comes_onto_a_map_by_its_owners(
    new_account, new_map, new_mission, sign_in, owner
):
    """Visitors with a link see the map's image, which editors of a map may not share."""
    ann = new_account("ann")
    slug, own = new_map(owner, shared={ann: "editor"}), new_map(ann, name="Own")
    browser = sign_in(ann)
    shared, private = new_mission(browser), new_mission(browser)
    assert browser.post(f"/api/v1/missions/{shared}/shares", json={}).status_code == 201
    answers = [browser.patch(f"/api/v1/missions/{id}", json={"map": slug}) for id in (shared, private)]
    assert [answer.status_code for answer in answers] == [403, 200]
    assert browser.get(f"/api/v1/missions/{shared}").json["map"] is None
    assert browser.patch(f"/api/v1/missions/{shared}", json={"map": own}).json["map"] == own


def test_deleted_for_good(client, library, mission, send, walk, add_photo, work):
    send([*walk(3), *walk(2, track="b")])
    add_photo()
    folder = library.folder / ".missions" / str(mission)
    assert folder.is_dir()
    address = f"/api/v1/missions/{mission}"
    client.delete(address)
    assert client.delete(f"{address}?forever=true").status_code == 200
    assert client.get(address).status_code == 404
    assert client.post(f"{address}/restore").status_code == 404
    assert client.get("/api/v1/missions?bin=true").json["missions"] == []
    work()
    assert client.get(address).status_code == 404
    assert not folder.exists()
    with library.database.read() as session:
        assert session.query(Pose).count() == session.query(Mission).count() == 0


class Stopped(Progress):
    """A progress that is cancelled at a given check."""

    def __init__(self, at):
        self.looks, self.at = 0, at

    def cancelled(self):
        self.looks += 1
        return self.looks == self.at


def test_a_deletion_that_is_stopped_leaves_shorter_tracks(
    client, library, mission, send, walk, state, monkeypatch
):
    monkeypatch.setattr(delete_mission, "_BLOCK", 40)
    car = {"type": "object", "id": "a", "class": "car", "time": 1.0, "lat": 50, "lon": 14}
    send([*walk(100), *[car] * 90])
    client.delete(f"/api/v1/missions/{mission}")
    write = library.database.write
    with pytest.raises(Cancelled):
        delete_mission.delete_mission(library, mission, write=write, progress=Stopped(2))
    client.post(f"/api/v1/missions/{mission}/restore")
    (track,) = state()["tracks"]
    assert track["poses"] == 20
    line = client.get(f"/api/v1/missions/{mission}/tracks/{track['id']}/line").json
    assert [point[0] for point in line["points"]] == list(range(20))
    client.delete(f"/api/v1/missions/{mission}")
    for _ in range(2):  # a second time, as if it had been killed at the end
        delete_mission.delete_mission(library, mission, write=write, progress=Progress())
    with library.database.read() as session:
        assert session.query(Mission).count() == session.query(ObjectSighting).count() == 0


def test_ids_are_never_used_again(client, new_mission, work):
    first = new_mission()
    client.delete(f"/api/v1/missions/{first}")
    client.delete(f"/api/v1/missions/{first}?forever=true")
    work()
    assert new_mission() > first


def test_a_deleted_map_leaves_its_missions(client, new_map, new_mission, owner):
    slug = new_map(owner)
    id = new_mission(map=slug)
    client.delete(f"/api/v1/maps/{slug}")
    client.delete(f"/api/v1/maps/{slug}?forever=true")
    assert client.get(f"/api/v1/missions/{id}").json["map"] is None


def test_the_list_describes_the_best_track(client, send, walk):
    send([*walk(5, source="odometry", track="a"), *walk(3)])
    (found,) = client.get("/api/v1/missions").json["missions"]
    assert (found["poses"], found["duration_s"]) == (8, 2)
    assert found["distance_m"] == pytest.approx(2, rel=1e-3)
    assert (found["first_time_s"], found["last_time_s"]) == (1000, 1004)


def test_the_list_knows_no_times_of_a_mission_without_poses(client, mission):
    (found,) = client.get("/api/v1/missions").json["missions"]
    assert (found["first_time_s"], found["last_time_s"]) == (None, None)


def test_the_page_of_missions_knows_where_maps_are_that_may_get_some(
    client, new_map, new_account, sign_in, owner, place_image
):
    ann = new_account("ann")
    shown = {role: new_map(owner, name=role, shared={ann: role}) for role in ("editor", "viewer")}
    for slug in shown.values():
        place_image(slug, (50.002, 13.998), (49.998, 14.002))
    page = sign_in(ann).get("/missions").text
    data = json.loads(re.search(r'id="page">(.*?)</script>', page)[1])
    boxes = {one["slug"]: one["box"] for one in data["maps"]}
    assert boxes[shown["editor"]] == pytest.approx([49.998, 13.998, 50.002, 14.002])
    assert boxes[shown["viewer"]] is None
    assert data["formats"]["names"].startswith("GPX, KML")


def test_the_list_adds_the_tracks_up_that_one_source_has(client, send, walk):
    parts = [walk(3, track="a"), walk(5, track="b"), walk(2, track="c")]
    send(
        [
            *(pose | {"time": pose["time"] + 100} for pose in parts[0]),
            *parts[1],
            *parts[2],
            *walk(9, source="odometry"),
        ]
    )
    (found,) = client.get("/api/v1/missions").json["missions"]
    assert found["distance_m"] == pytest.approx(2 + 4, rel=1e-3), "one overlaps with another"
    assert found["duration_s"] == 2 + 4


def test_previews_of_the_list(client, mission, send, walk, new_map, owner, place_image):
    listed = lambda: client.get("/api/v1/missions?previews=1").json["missions"][0]["preview"]  # noqa: E731
    assert listed() is None, "nothing to draw"
    thing = {"type": "object", "id": "a", "class": "car", "time": 1, "lat": 50 + 50 / 111_229, "lon": 14.0}
    send([*walk(101), thing])
    assert client.get("/api/v1/missions").json["missions"][0]["preview"] is None
    alone = listed()
    assert alone["image"] is None
    assert (alone["width"], alone["height"]) == pytest.approx((30, 130), abs=0.5)
    first, *_, last = ([*map(float, point.split())] for point in alone["line"][1:].split("L"))
    assert first == pytest.approx([15, 115], abs=0.5) and last == pytest.approx([15, 15], abs=0.5)
    assert alone["dots"].count("M") == 1
    slug = new_map(owner)
    place_image(slug, (50.002, 13.998), (49.998, 14.002))
    client.patch(f"/api/v1/missions/{mission}", json={"map": slug})
    on_image = listed()
    assert on_image["image"].startswith(f"/api/v1/maps/{slug}/thumbnail?v=")
    assert (on_image["width"], on_image["height"]) == (1000, 1000)
    assert on_image["line"].startswith("M500 500L")
    place_image(slug, (51.002, 13.998), (50.998, 14.002))
    assert listed()["image"] is None, "it is somewhere else"


def test_the_page_offers_images_of_maps_that_show_the_place(
    client, mission, send, walk, new_map, owner, place_image
):
    here, there = new_map(owner, name="Here"), new_map(owner, name="There")
    place_image(here, (50.002, 13.998), (49.998, 14.002))
    place_image(there, (51.002, 13.998), (50.998, 14.002))
    offered = '"maps": [{"name": "Here", "slug": "here"}]'
    assert '"maps": []' in client.get(f"/missions/{mission}").text
    send(walk(3))
    assert offered in client.get(f"/missions/{mission}").text
    client.patch(f"/api/v1/missions/{mission}", json={"map": here})
    assert '"maps": []' in client.get(f"/missions/{mission}").text, "its own is no other"


def test_a_track_that_closes(send, state):
    way = [(0, 0), (0, 50), (50, 50), (50, 0), (1, 0)]
    metres = [(n / 111_195, e / 111_195) for n, e in way]
    send([{"type": "pose", "time": t, "lat": lat, "lon": lon} for t, (lat, lon) in enumerate(metres)])
    closing = state()["tracks"][0]["closing"]
    assert closing["gap_m"] == pytest.approx(1, rel=0.02)
    assert closing["share"] == pytest.approx(1 / 199, rel=0.02)


def test_objects_in_pages(client, mission, send):
    seen = [
        {
            "type": "object",
            "id": f"o{n}",
            "class": "car" if n % 2 else "dog",
            "time": 10 - n,
            "lat": 0,
            "lon": 0,
        }
        for n in range(5)
    ]
    send(seen)
    address = f"/api/v1/missions/{mission}/objects"
    all_ = client.get(address).json
    assert [o["id"] for o in all_["objects"]] == ["o0", "o1", "o2", "o3", "o4"]
    assert all_["kinds"] == [{"kind": "car", "objects": 2}, {"kind": "dog", "objects": 3}]
    page = client.get(f"{address}?kind=dog&sort=last_time_s&limit=1&offset=1").json
    assert ([o["id"] for o in page["objects"]], page["total"]) == (["o2"], 3)
    assert client.get(f"{address}?sort=count&descending=true").status_code == 200
    assert client.get(f"{address}/none").status_code == 404
    assert client.get(f"{address}/o1").json["sightings"][0]["time_s"] == 9
