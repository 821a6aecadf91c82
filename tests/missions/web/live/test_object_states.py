"""The list of tasks: states of objects with author and time, permissions, and the view of visitors."""

import json

import pytest

CAR = {"type": "object", "id": "car-1", "class": "car", "time": 5.0, "lat": 50.0, "lon": 14.0}


@pytest.fixture
def car(send, mission):
    """The address of an object."""
    send([CAR, CAR | {"id": "car-2"}])
    return f"/api/v1/missions/{mission}/objects/car-1"


def test_states_have_a_history(client, car, owner, library):
    assert client.get(car).json["state"] == "found"
    for state, note in (("confirmed", "2\u202fe étage"), ("cleared", "")):
        answer = client.patch(car, json={"state": state, "note": note})
        assert (answer.status_code, answer.json["state"]) == (200, state)
    found = client.get(car).json
    changes = [(one["state"], one["by"], one["note"]) for one in found["changes"]]
    who = found["state_by"]
    assert changes == [("confirmed", who, "2\u202fe étage"), ("cleared", who, "")]
    assert found["state_time_s"] == found["changes"][1]["time_s"] >= found["changes"][0]["time_s"]


def test_a_tap_that_comes_twice_is_one_change(client, car, state):
    for _ in range(2):
        assert client.patch(car, json={"state": "confirmed", "was": "found"}).status_code == 200
    assert len(client.get(car).json["changes"]) == 1
    assert state()["revision"] == 2


def test_who_has_seen_another_state_is_told(client, car):
    client.patch(car, json={"state": "dismissed"})
    answer = client.patch(car, json={"state": "confirmed", "was": "found"})
    assert (answer.status_code, answer.json["error"]["where"]) == (409, "was")
    assert "dismissed" in answer.json["error"]["message"]
    assert client.get(car).json["state"] == "dismissed"


def test_a_wrong_state_of_an_object_that_nobody_has_touched(client, car):
    error = client.patch(car, json={"state": "cleared", "was": "confirmed"}).json["error"]
    assert (error["where"], error["message"]) == ("was", "the object is found: nobody has set another state")


@pytest.mark.parametrize(
    "given", [{}, {"state": "lost"}, {"state": "cleared", "was": 1}, {"state": "cleared", "note": "a\x00"}]
)
def test_only_states_are_taken(client, car, given):
    assert client.patch(car, json=given).status_code == 422


def test_an_unknown_object(client, car):
    assert client.patch(f"{car}0", json={"state": "cleared"}).status_code == 404


def test_a_sighting_keeps_the_state(client, car, send):
    client.patch(car, json={"state": "cleared"})
    send([CAR | {"time": 9.0}], first=2)
    assert (client.get(car).json["state"], client.get(car).json["count"]) == ("cleared", 2)


def test_editors_of_the_mission_may(send, new_account, new_map, new_mission, sign_in, owner):
    editor, viewer = new_account("ed"), new_account("vi")
    slug = new_map(owner, shared={editor: "editor", viewer: "viewer"})
    id = new_mission(map=slug)
    send([CAR], id=id)
    address = f"/api/v1/missions/{id}/objects/car-1"
    assert sign_in(viewer).patch(address, json={"state": "confirmed"}).status_code == 403
    answer = sign_in(editor).patch(address, json={"state": "confirmed"})
    assert (answer.status_code, answer.json["state_by"]) == (200, "ed")


def test_followers_hear_of_it(client, car, mission, state):
    cursor = state()["cursor"]
    client.patch(car, json={"state": "confirmed"})
    stream = client.get(f"/api/v1/missions/{mission}/events?cursor={cursor}", buffered=False).response
    event = next(piece for piece in map(bytes.decode, stream) if "event: changed" in piece)
    (changed,) = json.loads(event.split("data: ")[1])["objects"]
    assert (changed["id"], changed["state"]) == ("car-1", "confirmed")


def test_lists_queries_and_exports_have_it(client, car, mission):
    client.patch(car, json={"state": "confirmed", "note": "by the gate"})
    base = f"/api/v1/missions/{mission}"
    listed = client.get(f"{base}/objects?state=confirmed").json
    assert ([one["id"] for one in listed["objects"]], listed["total"]) == (["car-1"], 1)
    rows = client.get(f"{base}/query?from=changes&select=id,state,by,note").json["rows"]
    assert rows == [["car-1", "confirmed", "owner", "by the gate"]]
    features = client.get(f"{base}/export.geojson").get_json(force=True)["features"]
    assert [f["properties"]["state"] for f in features] == ["confirmed", "found"]
    assert features[0]["properties"]["state_by"] == "owner"
    assert b",confirmed,2" in client.get(f"{base}/objects.csv").data
    assert b'<Data name="state"><value>confirmed</value>' in client.get(f"{base}/export.kml").data


def test_visitors_see_the_state_and_nobodys_name(client, car, mission, app):
    client.patch(car, json={"state": "confirmed", "note": "ask Ann"})
    share = client.post(f"/api/v1/missions/{mission}/shares", json={}).json
    token = share["url"].rsplit("/", 1)[1]
    visitor = app.test_client()
    found = visitor.get(f"/api/v1/shared-missions/{token}/objects/car-1").json
    assert (found["state"], found["state_by"]) == ("confirmed", None)
    assert [(one["state"], one["by"], one["note"]) for one in found["changes"]] == [("confirmed", None, "")]
    for name in ("export.geojson", "objects.csv", "export.kml"):
        data = visitor.get(f"/m/{token}/{name}").data
        assert b"confirmed" in data and b"owner" not in data
