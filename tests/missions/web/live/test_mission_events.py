"""Followers of a mission receive every change, once."""

import dataclasses
import json
import time

import pytest

from webapp.errors import DatabaseUnavailable
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.missions.web import api_events
from webapp.missions.web.state import cursor, read_cursor
from webapp.settings import MissionSettings, Settings
from webapp.store.database import Database

CAR = {"type": "object", "id": "car-1", "class": "car", "time": 5.0, "lat": 50.0, "lon": 14.0}


@pytest.fixture
def stream_s():
    """How long a stream stays open, seconds."""
    return 0.6


@pytest.fixture
def settings(tmp_path, stream_s):
    limits = MissionSettings(stream_s=stream_s, look_s=0.05)
    return dataclasses.replace(Settings(library=tmp_path / "library"), missions=limits)


def parsed(text):
    """Return the data and ids of the events of a stream."""
    found = []
    for block in text.split("\n\n"):
        fields = dict(line.partition(": ")[::2] for line in block.splitlines())
        if fields.get("event") == "changed":
            found.append((json.loads(fields["data"]), fields["id"]))
    return found


@pytest.fixture
def follow(client, mission):
    """Read a stream to its end, and return its events."""

    def get(known=None, **query):
        headers = {} if known is None else {"Last-Event-ID": known}
        answer = client.get(f"/api/v1/missions/{mission}/events", headers=headers, query_string=query)
        assert (answer.status_code, answer.mimetype) == (200, "text/event-stream")
        return parsed(answer.text)

    return get


def numbers(data):
    return [point[0] for point in data["tracks"][0]["new"]]


def test_first_the_last_poses_are_sent(send, walk, follow):
    send(walk(300))
    ((data, id),) = follow()
    assert data["revision"] == 1
    assert numbers(data) == list(range(100, 300))
    assert data["tracks"][0]["poses"] == 300
    assert data["tracks"][0]["last"]["time_s"] == 1299
    assert read_cursor(id) == (1, {data["tracks"][0]["id"]: 300})


def test_then_what_is_new(send, walk, follow, state):
    send(walk(3))
    known = state()["cursor"]
    send([*walk(2, begin=3), CAR], first=3)
    ((data, id),) = follow(cursor=known)
    assert numbers(data) == [3, 4]
    assert data["tracks"][0]["new"][0] == [3, 1003, pytest.approx(50 + 3 / 111_229), 14, None]
    assert [o["id"] for o in data["objects"]] == ["car-1"]
    assert follow(id) == []
    send([CAR], first=6)
    ((data, _),) = follow(id)
    assert (data["tracks"], len(data["objects"])) == ([], 1)


@pytest.mark.parametrize("stream_s", [120.0])
def test_what_comes_while_one_listens(client, mission, send, walk, state):
    send(walk(3))
    known = state()["cursor"]
    answer = client.get(f"/api/v1/missions/{mission}/events?cursor={known}", buffered=False)
    stream = iter(answer.response)
    assert next(stream) == b"retry: 1000\n\n"
    send([*walk(2, begin=3), {"type": "end"}], first=3)
    begun = time.monotonic()
    ((data, _),) = parsed(next(stream).decode())
    assert time.monotonic() - begun < 60.0, "it came only when the stream ended"
    assert numbers(data) == [3, 4]
    assert data["ended_at"] is not None
    answer.close()


def test_of_very_many_poses_some_are_sent(send, walk, follow, state):
    send(walk(1))
    known = state()["cursor"]
    send(walk(4999, begin=1), first=1)
    ((data, _),) = follow(known)
    result = numbers(data)
    assert len(result) == 500
    assert (result[0], result[-1]) == (1, 4999)


@pytest.mark.parametrize("stream_s", [120.0])
def test_only_so_many_streams_stay_open(app, client, mission, follow, send, walk):
    permits = app.extensions["expmap_concurrency"]["events"]
    answers = [client.get(f"/api/v1/missions/{mission}/events", buffered=False) for _ in range(2)]
    assert not permits.acquire(blocking=False)
    send(walk(1))
    begun = time.monotonic()
    assert len(follow()) == 1
    assert time.monotonic() - begun < 60.0, "it stayed open"
    for answer in answers:
        answer.close()
        answer.close()
    assert permits.acquire(blocking=False)


def test_a_mission_in_the_bin_ends_the_stream(client, mission):
    answer = client.get(f"/api/v1/missions/{mission}/events", buffered=False)
    stream = iter(answer.response)
    next(stream), next(stream)
    client.delete(f"/api/v1/missions/{mission}")
    assert list(stream) == []
    assert client.get(f"/api/v1/missions/{mission}/events").status_code == 404


@pytest.mark.parametrize("stream_s", [120.0])
def test_a_database_that_is_away_ends_the_stream(client, mission, monkeypatch):
    def away():
        raise DatabaseUnavailable("the database server cannot be reached", wait_s=1)

    answer = client.get(f"/api/v1/missions/{mission}/events", buffered=False)
    stream = iter(answer.response)
    next(stream), next(stream)
    monkeypatch.setattr(Database, "read", lambda _: away())
    assert list(stream) == []


def test_what_changes_a_mission_is_announced(library, mission, monkeypatch):
    announced = []
    backend = type(library.database.backend)
    monkeypatch.setattr(backend, "announce", lambda _, connection, topic: announced.append(topic))
    with library.database.write() as session:
        missions.put_into_bin(session.get_one(Mission, mission))
    with library.database.write() as session:
        session.delete(session.get_one(Mission, mission))
    assert announced == [missions.topic_of(mission)] * 2


def test_nobody_else_follows(mission, new_account, sign_in):
    browser = sign_in(new_account("ann"))
    assert browser.get(f"/api/v1/missions/{mission}/events").status_code == 404


def test_cursors():
    assert read_cursor(cursor(7, {3: 100, 12: 0})) == (7, {3: 100, 12: 0})
    assert read_cursor(cursor(0, {})) == (0, {})
    for text in ("", "x", "1-2", "1-2.x", "-1", "1-2.3.4", "9" * 40, "1--2"):
        assert read_cursor(text) is None


def test_another_word_is_no_cursor(send, walk, follow):
    send(walk(2))
    ((data, _),) = follow("17; drop")
    assert numbers(data) == [0, 1]


def test_of_very_many_objects_each_comes_once_in_several_events(send, follow, state, monkeypatch):
    monkeypatch.setattr(api_events, "_MOST_OBJECTS", 10)
    known, first = state()["cursor"], 0
    for batch, count in enumerate([15, 4, 4, 4, 4, 4]):
        send([CAR | {"id": f"{batch}-{n}"} for n in range(count)], first=first)
        first += count
    found = follow(known)
    while found[-1][1] != state()["cursor"]:  # a slow stream ends before all is sent; browsers reconnect
        found += follow(found[-1][1])
    ids = [[o["id"] for o in data["objects"]] for data, _ in found]
    assert [len(some) for some in ids] == [15, 8, 8, 4]
    assert len({id for some in ids for id in some}) == 35
