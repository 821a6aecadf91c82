"""Robots say how they are; the server notes when it heard them, and logs their silences."""

import time

import pytest

from webapp.missions.store import robots as robot_store
from webapp.missions.store.schema import Mission

SAID = {"battery_percent": 81.5, "link_percent": 40.0, "mode": "auto", "text": "door is closed"}


@pytest.fixture
def robots(client, mission):
    """The robots of the mission, as the API answers."""
    return lambda: client.get(f"/api/v1/missions/{mission}/robots").json


def status(time_s=5.0, **said):
    return {"type": "status", "time": time_s, "track": "rover", **said}


def test_the_latest_status_is_shown_beside_its_robot(send, walk, robots):
    before = time.time()
    later = status(9.0, battery_percent=80, mode=None)
    assert send([*walk(3, track="rover"), later, status(**SAID), *walk(2)]).json["stored"] == 7
    found = robots()
    assert [one["name"] for one in found["robots"]] == ["", "rover"]
    rover = found["robots"][1]
    unsaid = dict.fromkeys(("link_percent", "mode", "text"))
    assert rover["status"] == {"time_s": 9.0, "battery_percent": 80.0, **unsaid}
    assert before <= rover["heard_time_s"] <= found["clock_s"]
    assert found["robots"][0]["status"] is None
    send([status(10.0, **SAID)], first=7)
    assert robots()["robots"][1]["status"] == {"time_s": 10.0, **SAID}


@pytest.mark.parametrize(
    "said", [{"battery_percent": 101}, {"link_percent": -1}, {"mode": ""}, {"text": "a\n"}, {"fuel": 3}]
)
def test_a_bad_status_is_refused_with_its_batch(send, robots, said):
    answer = send([status(), status(**said)])
    assert answer.status_code in (400, 422)
    assert answer.json["error"]["where"] == f"records.1.{next(iter(said))}"
    assert robots()["robots"] == []


def test_there_is_no_alarm_unless_it_is_set(client, mission, send, robots):
    send([status()])
    assert (robots()["silent_after_s"], robots()["silences"]) == (None, [])
    address = f"/api/v1/missions/{mission}"
    for bad in (0, -1, 1e9, "soon"):
        assert client.patch(address, json={"silent_after_s": bad}).status_code == 422
    assert client.patch(address, json={"silent_after_s": 60}).status_code == 200
    assert robots()["silent_after_s"] == 60
    client.patch(address, json={"silent_after_s": None})
    assert robots()["silent_after_s"] is None


def test_a_silent_robot_is_in_the_log_until_it_is_heard(client, mission, send, robots, library):
    send([status()])
    client.patch(f"/api/v1/missions/{mission}", json={"silent_after_s": 60})
    assert [one["silent"] for one in robots()["robots"]] == [False]
    since = time.time() - 100
    with library.database.write() as session:
        session.get_one(robot_store.RobotHeard, (mission, "rover")).time_s = since
    assert [one["silent"] for one in robots()["robots"]] == [True]
    (open_one,) = robots()["silences"]
    assert open_one == {"robot": "rover", "since_s": since, "until_s": None}
    send([status(6.0)], first=1)
    (over,) = robots()["silences"]
    assert (over["since_s"], robots()["robots"][0]["silent"]) == (since, False)
    assert over["until_s"] == robots()["robots"][0]["heard_time_s"]


def test_nobody_waits_for_a_robot_after_the_end(client, mission, send, robots, library):
    client.patch(f"/api/v1/missions/{mission}", json={"silent_after_s": 60})
    send([status(), {"type": "end"}])
    with library.database.write() as session:
        session.get_one(robot_store.RobotHeard, (mission, "rover")).time_s -= 100
        assert session.get_one(Mission, mission).ended_at is not None
    assert [one["silent"] for one in robots()["robots"]] == [False]


def test_only_those_who_see_the_mission_see_its_robots(mission, stranger, new_account, sign_in):
    address = f"/api/v1/missions/{mission}/robots"
    assert stranger.get(address).status_code == 401
    assert sign_in(new_account("other")).get(address).status_code == 404
