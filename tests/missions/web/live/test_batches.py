"""Batches are stored as a whole, and each of their records once."""

import json
import math
from urllib.parse import quote

import pytest

from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, MissionSender

CAR = {"type": "object", "id": "car-1", "class": "car", "time": 5.0, "lat": 50.0, "lon": 14.0}


def all_poses(library, track_id):
    with library.database.read() as session:
        track = session.get_one(tracks.Track, track_id)
        return tracks.read(session, track)


def test_poses_are_stored(send, walk, state):
    assert send(walk(11, heading_deg=370.0, skipped=2)).json == {
        "next": 11,
        "stored": 11,
        "already": 0,
        "revision": 1,
    }
    (track,) = state()["tracks"]
    assert (track["source"], track["name"], track["poses"], track["skipped"]) == ("gps", "", 11, 22)
    assert track["distance_m"] == pytest.approx(10, rel=1e-4)
    assert track["duration_s"] == 10
    assert track["bounds"] == pytest.approx([50, 14, 50 + 10 / 111_229, 14])
    assert track["last"] == {
        "time_s": 1010,
        "lat": 50 + 10 / 111_229,
        "lon": 14,
        "heading_deg": 10,
        "covariance_m2": None,
    }
    assert track["closing"] is None


def test_the_last_pose_has_its_covariance(send, walk, state):
    *rest, last = walk(5)
    send([*rest, {**last, "covariance": [4.0, 9.0, -1.5]}])
    assert state()["tracks"][0]["last"]["covariance_m2"] == pytest.approx([4.0, 9.0, -1.5])


def test_what_came_before_is_passed_over(send, walk, state, library):
    send(walk(5))
    answer = send(walk(6, begin=2), first=2).json
    assert (answer["next"], answer["stored"], answer["already"]) == (8, 3, 3)
    assert send(walk(8)).json == {"next": 8, "stored": 0, "already": 8, "revision": 2}
    poses = all_poses(library, state()["tracks"][0]["id"])
    assert poses.times_s.tolist() == [1000.0 + n for n in range(8)]
    assert poses.travelled_m == pytest.approx(range(8), abs=1e-3)


def test_a_gap_is_refused(send, walk, state):
    send(walk(5))
    answer = send(walk(1), first=6)
    assert answer.status_code == 409
    assert answer.json["error"]["next"] == 5
    assert answer.json["error"]["where"] == "first"
    assert answer.json["error"]["code"] == "conflict"
    assert state()["poses"] == 5


def test_senders_count_for_themselves(send, walk, state):
    send(walk(5), sender="a")
    assert send(walk(5), sender="b").json["stored"] == 5
    assert send([], sender="a").json["next"] == 5
    assert send([], sender="c").json["next"] == 0
    assert state()["poses"] == 10


def test_a_key_makes_a_batch_known_again(client, mission, walk, state):
    def post(key, records):
        address = f"/api/v1/missions/{mission}/batches"
        return client.post(address, json={"records": records}, headers={"Idempotency-Key": key})

    assert post("k1", walk(3)).json == {"next": None, "stored": 3, "already": 0, "revision": 1}
    assert post("k1", walk(3)).json == {"next": None, "stored": 0, "already": 3, "revision": 1}
    assert post("k2", walk(3)).json["stored"] == 3
    assert post("k1", walk(4)).status_code == 409
    assert state()["poses"] == 6


@pytest.mark.parametrize(
    "given", [{"records": []}, {"records": [], "sender": "a"}, {"records": [], "first": 0}]
)
def test_a_batch_says_how_to_know_it_again(client, mission, given):
    answer = client.post(f"/api/v1/missions/{mission}/batches", json=given)
    assert (answer.status_code, answer.json["error"]["where"]) == (400, "sender")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"lat": 90.5}, "lat"),
        ({"time": True}, "time"),
        ({"time": "now"}, "time"),
        ({"time": 10**90}, "time"),
        ({"source": "radar"}, "source"),
        ({"source": []}, "source"),
        ({"track": "a\x00"}, "track"),
        ({"covariance": [1, 1]}, "covariance"),
        ({"covariance": [1, 1, 2]}, "covariance"),
        ({"covariance": [-1, 1, 0]}, "covariance"),
        ({"covariance": [1, "1", 0]}, "covariance"),
        ({"skipped": -1}, "skipped"),
        ({"travelled_m": -1}, "travelled_m"),
        ({"speed": 1}, "speed"),
        ({"type": "pause"}, "type"),
        ({"type": ["pose"]}, "type"),
        ({"type": "object", "id": "", "class": "car"}, "id"),
        ({"type": "object", "id": "a"}, "class"),
        ({"type": "object", "id": "a", "class": "car", "confidence": -0.5}, "confidence"),
        ({"type": "object", "id": "a", "class": "car", "photo": "abc"}, "photo"),
    ],
)
def test_one_wrong_record_stores_none(send, walk, state, change, field):
    records = walk(3)
    records[1] = {**records[1], **change}
    answer = send(records)
    assert answer.status_code == 422
    assert answer.json["error"]["where"].split(".")[:2] == ["records", "1"]
    assert answer.json["error"]["where"].endswith(f".{field}")
    assert (state()["poses"], state()["revision"]) == (0, 0)
    assert send([]).json["next"] == 0


@pytest.mark.parametrize(
    "change", [{"lon": math.inf}, {"time": math.nan}, {"time": 10**400}, {"id": "\ud800"}]
)
def test_what_is_not_valid_json_stores_none(send, walk, state, change):
    records = walk(3)
    records[1] = {**records[1], **change}
    answer = send(records)
    assert (answer.status_code, answer.json["error"]["where"]) == (400, "body")
    assert (state()["poses"], state()["revision"]) == (0, 0)


@pytest.mark.parametrize("record", [None, 3, "pose", [], {}])
def test_a_record_that_is_none(send, record):
    assert send([record]).status_code == 422


def test_tracks_by_source_and_name(send, walk, state):
    send(walk(2) + walk(3, source="odometry") + walk(4, track="left"))
    found = {(t["source"], t["name"]): t["poses"] for t in state()["tracks"]}
    assert found == {("gps", ""): 2, ("odometry", ""): 3, ("gps", "left"): 4}


def test_the_distance_that_the_robot_reports(send, walk, state, library):
    records = walk(4)
    records[1]["travelled_m"] = 100.0
    send(records)
    send(walk(1, begin=4), first=4)
    poses = all_poses(library, state()["tracks"][0]["id"])
    assert poses.travelled_m == pytest.approx([0, 100, 101, 102, 103], abs=1e-3)
    assert state()["tracks"][0]["distance_m"] == pytest.approx(103, abs=1e-3)


def test_objects_are_where_they_were_seen_last(send, client, mission):
    later = {**CAR, "time": 9.0, "lat": 50.1, "class": "van", "confidence": 0.5}
    send([CAR, later, {**CAR, "time": 7.0, "lat": 49.0}])
    found = client.get(f"/api/v1/missions/{mission}/objects/car-1").json
    assert (found["lat"], found["kind"], found["confidence"]) == (50.1, "van", 0.5)
    assert (found["first_time_s"], found["last_time_s"]) == (5.0, 9.0)
    assert [s["time_s"] for s in found["sightings"]] == [5.0, 9.0, 7.0]


def test_the_end(send, state):
    assert state()["ended_at"] is None
    send([{"type": "end"}])
    assert state()["ended_at"] is not None


def test_what_is_not_sent_is_unknown(send, walk, state, library):
    send(walk(1))
    poses = all_poses(library, state()["tracks"][0]["id"])
    assert all(math.isnan(value) for value in (poses.height_m[0], *poses.covariance_m2[0]))
    assert state()["tracks"][0]["last"]["heading_deg"] is None


def test_too_many_records(send, walk):
    answer = send([{"type": "end"}] * 5001)
    assert (answer.status_code, answer.json["error"]["where"]) == (400, "records")


def test_too_large(client, mission):
    data = json.dumps({"sender": "a", "first": 0, "records": [{"type": "end", "x": "x" * 2_000_000}]})
    answer = client.post(f"/api/v1/missions/{mission}/batches", data=data, content_type="application/json")
    assert answer.status_code == 413


def test_a_busy_server_says_when_to_come_again(app, send, walk, state):
    permits = app.extensions["expmap_concurrency"]["batches"]
    taken = 0
    while permits.acquire(blocking=False):
        taken += 1
    answer = send(walk(2))
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "1")
    for _ in range(taken):
        permits.release()
    assert taken == 6
    assert send(walk(2)).json["stored"] == 2
    assert permits.acquire(blocking=False)


def test_nothing_is_kept_of_a_batch_whose_answer_fails(library, send, walk, state, monkeypatch):
    def fail(*_args, **_more):
        raise OSError("no")

    monkeypatch.setattr("webapp.missions.store.batches.add_sightings", fail)
    with pytest.raises(OSError, match="no"):
        send([*walk(3), CAR])
    monkeypatch.undo()
    with library.database.read() as session:
        assert session.query(MissionSender).count() == 0
        assert session.query(Mission).one().revision == 0
    assert send(walk(3)).json == {"next": 3, "stored": 3, "already": 0, "revision": 1}
    assert state()["poses"] == 3


def test_who_may_send(send, walk, new_account, new_map, new_mission, sign_in, owner):
    editor, viewer, other = (new_account(name) for name in ("ed", "vi", "ot"))
    slug = new_map(owner, shared={editor: "editor", viewer: "viewer"})
    id = new_mission(map=slug)
    assert send(walk(1), browser=sign_in(editor), id=id).status_code == 200
    assert send(walk(1), browser=sign_in(viewer), id=id).status_code == 403
    assert send(walk(1), browser=sign_in(other), id=id).status_code == 404


def test_the_end_reports_what_was_left_out_after_the_last_pose(send, walk, state):
    rest = {"source": "gps", "track": "", "skipped": 7, "travelled_m": 12.5}
    assert send([*walk(3, skipped=1), {"type": "end", "left_out": [rest]}]).json["stored"] == 4
    (track,) = state()["tracks"]
    assert (track["poses"], track["skipped"], track["distance_m"]) == (3, 10, 12.5)


@pytest.mark.parametrize(
    ("result", "where"),
    [
        ("x", "left_out"),
        ([{"gap": 1}], "gap"),
        ([{"skipped": -1}], "skipped"),
        ([{"source": 1}], "source"),
    ],
)
def test_the_end_record_is_checked(send, result, where):
    answer = send([{"type": "end", "left_out": result}])
    assert answer.status_code == 422
    assert answer.json["error"]["where"].endswith(f"records.0.{where}")


def test_nobody_takes_the_place_of_an_imported_file(send, walk, client, mission):
    assert send(walk(1), sender="import:abc").status_code == 422
    address, key = f"/api/v1/missions/{mission}/batches", {"Idempotency-Key": "import:abc"}
    assert client.post(address, json={"records": walk(1)}, headers=key).status_code == 422


def test_of_very_many_sightings_the_last_are_listed(send, client, mission, monkeypatch):
    monkeypatch.setattr(missions, "MOST_SIGHTINGS", 5)
    send([CAR | {"time": float(n)} for n in range(12)])
    found = client.get(f"/api/v1/missions/{mission}/objects/car-1").json
    assert found["count"] == 12
    assert [seen["time_s"] for seen in found["sightings"]] == [7, 8, 9, 10, 11]


@pytest.mark.parametrize("id", ["/camera/detections 3", "a//b", "50 %", "?x#y", "auto č. 1"])
def test_objects_have_any_ids(send, client, mission, id):
    send([CAR | {"id": id}])
    answer = client.get(f"/api/v1/missions/{mission}/objects/{quote(id, safe='')}")
    assert (answer.status_code, answer.json["id"]) == (200, id)
