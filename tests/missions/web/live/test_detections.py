"""Detections of robots: accuracy, size, and association to objects without an id."""

import numpy as np
import pytest

SIGMA_M = 3.0
METRE_EAST = 1 / 71_700


def victim(east, north=0.0, *, time=0.0, **more):
    """Return a detection at an offset from the origin, metres."""
    at = {"lat": 50 + north / 111_229, "lon": 14 + east * METRE_EAST, "time": time}
    covariance = [SIGMA_M**2, SIGMA_M**2, 0]
    return {"type": "object", "class": "victim", "covariance": covariance, **at, **more}


@pytest.fixture
def objects(client, mission):
    """Give the objects of the mission by their ids."""

    def listed():
        found = client.get(f"/api/v1/missions/{mission}/objects").json["objects"]
        return {one["id"]: one for one in found}

    return listed


@pytest.fixture
def one(client, mission):
    return lambda id: client.get(f"/api/v1/missions/{mission}/objects/{id.replace('#', '%23')}").json


def detections(count):
    """Return alternating detections of two objects 30 m apart."""
    noise = np.random.default_rng(4).normal(0, SIGMA_M, (count, 2, 2))
    return [
        victim(30.0 * o + e, n, time=10.0 * k + 3 * o)
        for k, both in enumerate(noise)
        for o, (e, n) in enumerate(both)
    ]


@pytest.mark.parametrize("size", [1, 7, 40])
def test_two_objects_are_two_however_the_batches_are_cut(send, objects, one, size):
    seen = detections(20)
    for first in range(0, len(seen), size):
        assert send(seen[first : first + size], first=first).status_code == 200
    found = objects()
    assert {id: (o["count"], o["associated"]) for id, o in found.items()} == {
        "victim #1": (20, True),
        "victim #2": (20, True),
    }
    west, east = found["victim #1"], found["victim #2"]
    assert (east["lon"] - west["lon"]) / METRE_EAST == pytest.approx(30, abs=3)
    assert west["covariance"] == pytest.approx([0.45, 0.45, 0], abs=0.01)
    history = one("victim #1")["sightings"]
    assert [s["time_s"] for s in history] == [10.0 * k for k in range(20)]
    assert history[0]["covariance"] == [9, 9, 0]


def test_a_repeat_by_another_sender_changes_nothing(send, objects):
    send(detections(5))
    before = objects()
    assert send(detections(5), sender="spare").json["stored"] == 10
    assert objects() == before


def test_objects_with_an_id_are_never_joined(send, objects):
    send([victim(0, time=1, id="v"), victim(0, time=2), victim(0.1, time=3, id="w"), victim(0, time=4)])
    assert {id: (o["count"], o["associated"]) for id, o in objects().items()} == {
        "v": (1, False),
        "w": (1, False),
        "victim #1": (2, True),
    }


def test_an_id_of_a_robot_that_looks_like_ours_stays_apart(send, objects):
    send([victim(0, time=1, id="victim #1"), victim(0, time=2)])
    send([victim(0, time=3, id="victim #2"), victim(0, time=4, id="victim #2")], first=2)
    assert {id: (o["count"], o["associated"]) for id, o in objects().items()} == {
        "victim #1": (1, False),
        "victim #2": (1, True),
        "victim #2 (2)": (2, False),
    }


def test_accuracy_and_size_are_kept_and_exported(send, objects, client, mission):
    send([victim(0, time=1, id="v", size_m=[1.8, 0.5, 0.3]), victim(5, time=2, id="v", covariance=None)])
    (found,) = objects().values()
    assert (found["size_m"], found["covariance"]) == ([1.8, 0.5, 0.3], None)
    address = f"/api/v1/missions/{mission}"
    rows = client.get(f"{address}/query?from=sightings&select=time,var_e,size_x_m&order=time").json["rows"]
    assert rows == [[1, 9, 1.8], [2, None, None]]
    feature = client.get(f"{address}/export.geojson").get_json(force=True)["features"][0]
    assert feature["properties"]["size_m"] == [1.8, 0.5, 0.3]
    assert b'<Data name="size_m"><value>1.8 0.5 0.3</value>' in client.get(f"{address}/export.kml").data


@pytest.mark.parametrize("size", [1.0, [1, 2], [1, 2, -1], [1, 2, "3"]])
def test_a_size_is_three_lengths(send, size):
    answer = send([victim(0, size_m=size)])
    assert (answer.status_code, answer.json["error"]["where"]) == (422, "records.0.size_m")
