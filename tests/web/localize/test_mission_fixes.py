"""Visual fixes: robots localize themselves by photos."""

import csv
import io
import math
import shutil

import numpy as np
import pytest
from PIL import Image
from sqlalchemy import select

from webapp.app.registry import REGISTRY
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.jobs import map_jobs
from webapp.jobs.worker import Worker
from webapp.missions.core.trajectory import fusion
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import MissionPhoto
from webapp.missions.tasks import fuse as fuse_mission
from webapp.store.schema import Job
from webapp.tasks.maps.library_map import georeference

KEYS = {
    "query", "method", "features", "fov_deg", "fov_source", "hypotheses", "other_probability",
    "off_map_probability", "statistics", "seconds", "map_revision", "map_kind", "place_radius_px", "looks",
    "verdict", "sentence",
    "photo", "time", "lat", "lon", "heading_deg", "position_covariance_m2", "no_pose",
}  # fmt: skip


@pytest.fixture
def mission(client, sample):
    """The address of a mission on the sample map."""
    made = client.post("/api/v1/missions", json={"name": "Round", "map": "sample"})
    assert made.status_code == 201, made.json
    return f"/api/v1/missions/{made.json['id']}"


@pytest.fixture
def send(client):
    """Send a photo and return the answer."""

    def post(address, photo, *, browser=client, **fields):
        data = {**fields, "file": (io.BytesIO(photo.read_bytes()), photo.name)}
        return browser.post(address, data=data, content_type="multipart/form-data")

    return post


@pytest.fixture
def truth_of(queries, record):
    """Return the position of a query, degrees."""

    def read(name):
        with (queries.parent / "queries.csv").open(encoding="utf-8", newline="") as file:
            rows = {row["path"]: row for row in csv.DictReader(file, delimiter=";")}
        row = rows[f"queries/{name}"]
        return georeference(record()).latlon_of(MapPixel(float(row["x"]), float(row["y"])))

    return read


def visual_poses(library):
    with library.database.read() as session:
        found = [t for t in tracks.list_tracks(session, 1) if t.source == "visual"]
        return tracks.read(session, found[0]) if found else None


def test_the_answer_has_position_and_accuracy(client, mission, send, queries, truth_of, library):
    answer = send(f"{mission}/fixes", queries / "query_01.jpg", time=1000.5)
    assert answer.status_code == 200, answer.json
    result = answer.json
    assert result.keys() == KEYS
    assert (result["time"], result["no_pose"]) == (1000.5, None)
    off = LocalFrame(truth_of("query_01.jpg")).enu_of(LatLon(result["lat"], result["lon"]))
    covariance = np.array(result["position_covariance_m2"])
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.array(off[:2]) @ np.linalg.solve(covariance, off[:2]) < 14
    radius = result["hypotheses"][0]["radius_m"]
    assert math.sqrt(np.trace(covariance) / 2) * 1.5096 == pytest.approx(radius, rel=0.02)
    poses = visual_poses(library)
    assert poses.times_s.tolist() == [1000.5]
    assert poses.latlon[0].tolist() == [result["lat"], result["lon"]]
    assert poses.heading_deg[0] == pytest.approx(result["heading_deg"])
    assert poses.covariance_m2[0].tolist() == [covariance[0, 0], covariance[1, 1], covariance[0, 1]]
    (photo,) = client.get(f"{mission}/photos").json["photos"]
    assert (photo["sha256"], photo["fix_state"], photo["time_s"]) == (result["photo"], "done", 1000.5)
    assert photo["fix"]["lat"] == result["lat"]


def test_off_the_map_there_is_no_pose(mission, send, queries, library):
    answer = send(f"{mission}/fixes", queries / "off_map.jpg", time=5)
    assert answer.status_code == 200
    assert answer.json["lat"] is answer.json["position_covariance_m2"] is None
    assert "not taken on this map" in answer.json["no_pose"]
    assert visual_poses(library) is None


def test_sent_again_it_is_one_pose(mission, send, queries, library):
    for time in (1000, 1000, 1001):
        assert send(f"{mission}/fixes", queries / "query_01.jpg", time=time).status_code == 200
    assert visual_poses(library).times_s.tolist() == [1001]
    assert send(f"{mission}/fixes", queries / "query_02.jpg", time=900).status_code == 200
    assert visual_poses(library).times_s.tolist() == [1001, 900]


def test_without_a_time_there_is_an_answer_but_no_pose_is_kept(mission, send, queries, library):
    answer = send(f"{mission}/fixes", queries / "query_01.jpg")
    assert (answer.json["time"], answer.json["no_pose"]) == (None, None)
    assert visual_poses(library) is None


def test_a_hint_near_the_truth_and_one_far_away(mission, send, queries, truth_of):
    lat, lon = truth_of("query_01.jpg")
    near = {"hint_lat": lat, "hint_lon": lon, "hint_radius_m": 60, "time": 1}
    assert send(f"{mission}/fixes", queries / "query_01.jpg", **near).json["no_pose"] is None
    far = {**near, "hint_lat": lat + 0.5}
    assert send(f"{mission}/fixes", queries / "query_01.jpg", **far).status_code in (400, 422)
    half = {"hint_lat": lat, "time": 1}
    assert send(f"{mission}/fixes", queries / "query_01.jpg", **half).json["error"]["where"] == "hint_lat"


def test_who_may_ask(client, mission, send, queries, sign_in, new_account, stranger):
    other = sign_in(new_account("eva"))
    assert send(f"{mission}/fixes", queries / "query_01.jpg", browser=other).status_code == 404
    assert send(f"{mission}/fixes", queries / "query_01.jpg", browser=stranger).status_code == 401
    assert other.post(f"{mission}/fuse").status_code == 404
    assert client.post("/api/v1/missions/99/fuse").status_code == 404


def test_a_mission_on_no_map_says_so(client, send, queries):
    id = client.post("/api/v1/missions", json={"name": "Globe"}).json["id"]
    for address in (f"/api/v1/missions/{id}/fixes", f"/api/v1/missions/{id}/photos?fix=1"):
        answer = send(address, queries / "query_01.jpg", time=1)
        assert answer.status_code == 404
        assert "not on a map" in answer.json["error"]["message"]
    assert client.get(f"/api/v1/missions/{id}/photos").json["photos"] == []


def test_no_photo_is_refused(client, mission, tmp_path, send):
    text = tmp_path / "a.jpg"
    text.write_text("no photo")
    assert send(f"{mission}/fixes", text, time=1).status_code == 422


def test_photos_are_localized_in_the_background(client, mission, send, queries, library, settings):
    sent = send(f"{mission}/photos?fix=1", queries / "query_01.jpg", time=10)
    assert sent.json["fix_state"] == "queued"
    later = send(f"{mission}/photos", queries / "off_map.jpg", time=11).json["sha256"]
    queued = client.post(f"{mission}/photos/{later}/fix")
    assert queued.status_code == 202
    Worker(library, settings, registry=REGISTRY).run(once=True)
    job = client.get(f"/api/v1/jobs/{queued.json['job']}").json
    assert (job["state"], job["result"]) == ("done", {"localized": 1, "no_pose": 1, "failed": 0})
    photos = client.get(f"{mission}/photos").json["photos"]
    assert [photo["fix_state"] for photo in photos] == ["done", "done"]
    assert visual_poses(library).times_s.tolist() == [10]


def test_a_photo_that_is_missing_on_the_disk_fails_alone(client, mission, send, queries, library, settings):
    send(f"{mission}/photos?fix=1", queries / "query_01.jpg", time=10)
    gone = send(f"{mission}/photos?fix=1", queries / "query_02.jpg", time=11).json["sha256"]
    with library.database.read() as session:
        path = session.scalars(select(MissionPhoto.path).where(MissionPhoto.sha256 == gone)).one()
    (missions.folder(library, 1) / path).unlink()
    Worker(library, settings, registry=REGISTRY).run(once=True)
    states = {p["sha256"]: p["fix_state"] for p in client.get(f"{mission}/photos").json["photos"]}
    assert states.pop(gone) == "failed"
    assert set(states.values()) == {"done"}


def test_the_index_is_built_where_it_is_missing(
    client, mission, send, queries, library, settings, ready_sample, monkeypatch
):
    derived = library.map_folder("sample") / "derived"
    shutil.rmtree(derived)

    def build(_context):
        shutil.copytree(ready_sample / "derived", derived, dirs_exist_ok=True)
        return {}

    monkeypatch.setattr(map_jobs, "build_map_index", build)
    send(f"{mission}/photos?fix=1", queries / "query_01.jpg", time=10)
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert client.get(f"{mission}/photos").json["photos"][0]["fix_state"] == "done"


def test_tracks_are_fused_on_demand(client, mission, send, queries, library, settings):
    send(f"{mission}/fixes", queries / "query_01.jpg", time=10)
    assert client.get(f"{mission}/fusion").status_code == 404
    queued = client.post(f"{mission}/fuse")
    assert queued.status_code == 202
    assert f'"fusion": {queued.json["job"]}' in client.get(mission.removeprefix("/api/v1")).text
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert client.get(f"/api/v1/jobs/{queued.json['job']}").json["state"] == "done"
    assert '"fusion": null' in client.get(mission.removeprefix("/api/v1")).text
    report = client.get(f"{mission}/fusion").json
    assert (report["poses"], report["gated"]) == (1, [])
    picture = client.get(f"{mission}/fusion.png")
    assert picture.mimetype == "image/png"
    assert Image.open(io.BytesIO(picture.data)).width >= 640
    assert [track["source"] for track in client.get(mission).json["tracks"]] == ["visual", "fused"]


def test_a_corrected_track_is_removed(client, mission, send, queries, library, settings):
    send(f"{mission}/fixes", queries / "query_01.jpg", time=10)
    before = client.get(mission).json
    client.post(f"{mission}/fuse")
    Worker(library, settings, registry=REGISTRY).run(once=True)
    fused = client.get(mission).json
    photo = client.get(f"{mission}/photos").json["photos"][0]
    assert photo["fix"]["gated"] is False
    assert client.delete(f"{mission}/fusion").status_code == 204
    after = client.get(mission).json
    assert after["tracks"] == before["tracks"] and after["revision"] > fused["revision"]
    assert client.get(f"{mission}/fusion").status_code == 404
    assert "gated" not in client.get(f"{mission}/photos").json["photos"][0]["fix"]
    stream = client.get(f"{mission}/events?cursor={fused['cursor']}", buffered=False)
    first = next(part for part in stream.response if b"track_ids" in part).decode()
    assert f'"track_ids":[{before["tracks"][0]["id"]}]' in first
    stream.close()
    assert client.delete(f"{mission}/fusion").status_code == 404


def test_removing_a_corrected_track_cancels_what_would_bring_it_back(
    client, mission, send, queries, library, settings, monkeypatch
):
    send(f"{mission}/fixes", queries / "query_01.jpg", time=10)
    client.post(f"{mission}/fuse")
    Worker(library, settings, registry=REGISTRY).run(once=True)
    waiting = client.post(f"{mission}/fuse").json["job"]
    assert client.delete(f"{mission}/fusion").status_code == 204
    assert client.get(f"/api/v1/jobs/{waiting}").json["state"] == "cancelled"
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert [track["source"] for track in client.get(mission).json["tracks"]] == ["visual"]

    def remove_before_it_writes(*arguments, **options):
        result = fusion.fuse(*arguments, **options)
        assert client.delete(f"{mission}/fusion").status_code == 204
        return result

    running = client.post(f"{mission}/fuse").json["job"]
    monkeypatch.setattr(fuse_mission, "fuse", remove_before_it_writes)
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert client.get(f"/api/v1/jobs/{running}").json["state"] == "cancelled"
    assert [track["source"] for track in client.get(mission).json["tracks"]] == ["visual"]


def test_nothing_to_fuse_fails_with_words(client, mission, library, settings):
    job = client.post(f"{mission}/fuse").json["job"]
    Worker(library, settings, registry=REGISTRY).run(once=True)
    result = client.get(f"/api/v1/jobs/{job}").json
    assert result["state"] == "failed"
    assert "no fix" in result["error"]["message"]
    with library.database.read() as session:
        assert session.get_one(Job, job).map_id is not None
