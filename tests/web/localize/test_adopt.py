"""A query photo becomes an experience of the map, and answers use the present state of the map."""

from pathlib import Path

import pytest
from sqlalchemy import func, select

from webapp.progress import Progress
from webapp.store.schema import Job, Photo
from webapp.tasks.localize import build_map
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.maps.export import export_late_maps


def photos(library, map_id):
    with library.database.read() as session:
        return session.scalar(select(func.count()).where(Photo.map_id == map_id, ~Photo.removed))


def index_jobs(library, map_id):
    with library.database.read() as session:
        waiting = (Job.map_id == map_id, Job.kind == "index", Job.state == "queued")
        return session.scalar(select(func.count()).where(*waiting))


@pytest.fixture
def quiet(library, sample):
    """The map without queued jobs."""
    with library.database.write() as session:
        for job in session.scalars(select(Job)):
            session.delete(job)
    return sample


def test_adopting_makes_one_experience_and_one_index_job(client, library, quiet, ask, queries):
    answer = ask(client, queries / "query_01.jpg").get_json()
    before, address = photos(library, quiet), f"/api/v1/maps/sample/queries/{answer['id']}"
    response = client.post(f"{address}/adopt", json={})
    done, first = response.get_json(), answer["hypotheses"][0]
    assert response.status_code == 201
    assert (done["x_px"], done["y_px"]) == pytest.approx((first["x_px"], first["y_px"]))
    assert done["heading_deg"] == pytest.approx(first["heading_deg"])
    assert (photos(library, quiet), index_jobs(library, quiet)) == (before + 1, 1)
    assert client.get(address).get_json()["adopted"] == done["id"]
    export_late_maps(library)
    assert f"\n{done['id']};" in library.cfg("sample").read_text()
    assert client.post(f"{address}/adopt", json={}).status_code == 409
    assert photos(library, quiet) == before + 1
    assert client.get(f"{address}/photo", buffered=True).data == (queries / "query_01.jpg").read_bytes()
    client.post("/api/v1/maps/sample/undo")
    state = client.get("/api/v1/maps/sample").get_json()
    assert next(p for p in state["photos"] if p["id"] == done["id"])["x_px"] is None
    assert client.post(f"{address}/adopt", json={"x_px": 10, "y_px": 20}).get_json()["id"] == done["id"]


def test_adopting_at_a_corrected_place(client, sample, ask, queries):
    id = ask(client, queries / "off_map.jpg").get_json()["id"]
    place = {"x_px": 12.5, "y_px": 30.25, "heading_deg": 90}
    done = client.post(f"/api/v1/maps/sample/queries/{id}/adopt", json=place).get_json()
    assert {key: done[key] for key in place} == place


@pytest.mark.parametrize(
    "place", [{"x_px": -1, "y_px": 5}, {"x_px": 5}, {"x_px": 1e9, "y_px": 1}, {"x_px": "here", "y_px": 1}]
)
def test_a_place_outside_the_image_is_refused(client, library, sample, ask, queries, place):
    id, before = ask(client, queries / "query_01.jpg").get_json()["id"], photos(library, sample)
    response = client.post(f"/api/v1/maps/sample/queries/{id}/adopt", json=place)
    assert response.status_code in (400, 422) and photos(library, sample) == before


def test_a_moved_photo_counts_at_once(client, sample, ask, queries):
    """If all photos are moved by 7 pixels, so is the answer."""
    before = ask(client, queries / "query_01.jpg").get_json()
    state = client.get("/api/v1/maps/sample").get_json()
    moved = [{"id": p["id"], "x_px": p["x_px"] + 7, "y_px": p["y_px"]} for p in state["photos"]]
    assert client.patch("/api/v1/maps/sample/experiences", json={"changes": moved}).status_code == 200
    after = ask(client, queries / "query_01.jpg").get_json()
    assert after["map_revision"] == before["map_revision"] + 1
    shift = after["hypotheses"][0]["x_px"] - before["hypotheses"][0]["x_px"]
    assert shift == pytest.approx(7, abs=1.5)


def test_a_new_photo_is_reported_until_it_is_indexed(client, library, settings, quiet, ask, queries):
    answer = ask(client, queries / "query_01.jpg").get_json()
    client.post(f"/api/v1/maps/sample/queries/{answer['id']}/adopt", json={})
    assert ask(client, queries / "query_01.jpg").get_json()["not_indexed"] == 1
    assert index_jobs(library, quiet) == 1
    options = OpenOptions(features="sift", jobs=1)
    export_late_maps(library)
    report = build_map.build_map(library.cfg("sample"), options, settings=settings, progress=Progress())
    assert report.index.extracted == 1
    answer = ask(client, queries / "query_01.jpg").get_json()
    assert answer["not_indexed"] == 0
    newest = max(p["id"] for p in client.get("/api/v1/maps/sample").get_json()["photos"])
    assert newest in answer["hypotheses"][0]["experiences"]


def test_an_open_map_is_used_again_until_something_changes(client, library, settings, sample):
    maps = MapCache(library, settings, most=2)
    first = maps.get(sample, OpenOptions())
    assert maps.get(sample, OpenOptions()).pipeline.opened is first.pipeline.opened
    client.patch("/api/v1/maps/sample/experiences/3", json={"x_px": 5, "y_px": 5})
    moved = maps.get(sample, OpenOptions())
    assert moved.revision == first.revision + 1
    assert moved.pipeline.opened.indexed.search is first.pipeline.opened.indexed.search
    assert moved.pipeline.map.experiences[3].position == (5, 5)


def test_the_maps_asked_longest_ago_are_closed(library, settings, sample):
    maps = MapCache(library, settings, most=1)
    first = maps.get(sample, OpenOptions())
    maps.get(sample, OpenOptions("vote"))
    assert maps.get(sample, OpenOptions()).pipeline.opened is not first.pipeline.opened


def test_probabilities_before_the_calibration_are_said_to_be_so(client, library, sample, ask, queries):
    for path in Path(library.map_folder("sample")).rglob("calibration-*.json"):
        path.unlink()
    answer = ask(client, queries / "query_01.jpg").get_json()
    assert answer["calibrated"] is False and answer["hypotheses"]
