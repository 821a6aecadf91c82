"""The client with a server that fails in every way."""

import hashlib
import io
import logging
import os
import socket
import time

import pytest

from tests.robot.damage import damage_record
from tests.robot.stand_in import refused
from webapp.errors import Conflict, DiskFull, InputError, NotSignedIn, UsageError
from webapp.robot import RobotClient
from webapp.robot.content import read_content
from webapp.robot.uploader import Backoff


@pytest.fixture
def start(tmp_path, server, quick):
    """Start a client of mission 7; it is closed at the end."""
    started = []

    def start(**more):
        url = more.pop("url", server.url)
        client = RobotClient(url, "token", mission=7, spool=tmp_path / "spool", options=quick(**more))
        started.append(client)
        return client

    yield start
    for client in started:
        client.close(wait_s=0)


def send(client, count, *, begin=0):
    for number in range(begin, begin + count):
        client.pose(50 + number * 1e-5, 14, time_s=number)


def times(server):
    return [record["time"] for record in server.stored()]


def test_records_arrive_unchanged(start, server):
    client = start()
    covariance = [0.8, 0.9, 0.1]
    client.pose(50, 14, time_s=1, heading_deg=-90, height_m=200, covariance=covariance, source="odometry")
    client.pose(50.1, 14.1, time_s=2, track="left", travelled_m=3, skipped=4)
    client.object("car 1", "car", lat=50, lon=14.2, time_s=3, confidence=0.5)
    client.report(battery_percent=81, mode="auto", track="left", time_s=4)
    client.end()
    assert client.upload(wait_s=60)
    assert server.stored() == [
        {"type": "pose", "time": 1, "lat": 50, "lon": 14, "height_m": 200, "heading_deg": 270,
         "covariance": covariance, "source": "odometry"},
        {"type": "pose", "time": 2, "lat": 50.1, "lon": 14.1, "travelled_m": 3, "track": "left",
         "skipped": 4},
        {"type": "object", "id": "car 1", "class": "car", "time": 3, "lat": 50, "lon": 14.2,
         "confidence": 0.5},
        {"type": "status", "time": 4, "battery_percent": 81, "mode": "auto", "track": "left"},
        {"type": "end"},
    ]  # fmt: skip
    path, body = server.requests[0]
    assert path == "/api/v1/missions/7/batches" and body["token"] == "Bearer token"
    status = client.status()
    assert (status.written, status.waiting, status.online, status.problem) == (5, 0, True, "")


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"lat": 91}, "lat"),
        ({"lat": float("nan")}, "lat"),
        ({"lon": "east"}, "lon"),
        ({"time_s": float("inf")}, "time"),
        ({"heading_deg": float("nan")}, "heading_deg"),
        ({"covariance": [1, 2]}, "covariance"),
        ({"covariance": [1, 1, 2]}, "covariance"),
        ({"source": "guess"}, "source"),
        ({"track": "a\nb"}, "track"),
        ({"haeding": 3}, "haeding"),
    ],
)
def test_invalid_fields_are_refused_before_they_are_stored(start, fields, where):
    client = start(every_s=None)
    with pytest.raises(InputError) as refusal:
        client.pose(**{"lat": 50, "lon": 14} | fields)
    assert refusal.value.where == where
    assert client.status().written == 0


def test_records_as_they_are_sent(start, server):
    client = start()
    client.send({"type": "pose", "lat": 50, "lon": 14, "time": 1})
    client.send({"type": "object", "id": "a", "class": "car", "lat": 50, "lon": 14})
    for wrong in ({"type": "pose", "lat": 50}, {"type": "walk"}, {"type": "object", "lat": 1, "lon": 2}, {}):
        with pytest.raises(InputError):
            client.send(wrong)
    assert client.upload(wait_s=60)
    assert server.stored()[1]["class"] == "car" and abs(server.stored()[1]["time"] - time.time()) < 60


def test_batches_have_at_most_so_many_records_and_bytes(start, server):
    client = start(every_s=None, batch_records=10)
    send(client, 95)
    assert client.upload(wait_s=60) and times(server) == list(range(95))
    assert [len(body["records"]) for _, body in server.requests] == [10] * 9 + [5]
    client.close()
    client = start(every_s=None, batch_kb=0.5)
    send(client, 95)
    assert client.upload(wait_s=60) and len(server.requests) > 20


def test_nothing_is_sent_before_the_command(start, server, until):
    client = start(every_s=None)
    send(client, 5)
    time.sleep(0.1)
    assert server.requests == []
    client.upload()
    until(lambda: client.status().waiting == 0)


def test_the_end_reports_what_was_left_out(start, server):
    client = start(min_move="1m")
    for number in (0, 1, 1, 1):
        send(client, 1, begin=number)
    client.pose(50, 14, time_s=9, track="other")
    client.end()
    client.send({"type": "end"})
    assert client.upload(wait_s=60)
    first, again = server.stored()[-2:]
    (rest,) = first["left_out"]
    assert (rest["source"], rest["track"], rest["skipped"]) == ("gps", "", 2)
    assert rest["travelled_m"] == pytest.approx(1.11, abs=0.01)
    assert again == {"type": "end"}


def test_records_are_sent_by_the_timer(start, server, until):
    client = start()
    for number in range(3):
        send(client, 1, begin=number)
        until(lambda: client.status().waiting == 0)
    assert times(server) == [0, 1, 2]


def test_records_are_sent_at_the_end(start, server, until):
    client = start(every_s=None)
    send(client, 5)
    client.end()
    until(lambda: client.status().waiting == 0)
    assert server.stored()[-1] == {"type": "end"}


def test_offline_it_queues_and_then_catches_up(start, server, until, caplog):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        client = start(url=f"http://127.0.0.1:{unused.getsockname()[1]}")
        send(client, 20)
        until(lambda: client.status().online is False)
        assert "refused" in client.status().problem and client.status().waiting == 20
        assert not client.close(wait_s=0.1)
    assert [r.levelno for r in caplog.records] == [logging.WARNING]  # once, not at every attempt
    client = start()
    send(client, 20, begin=20)
    assert client.upload(wait_s=60) and times(server) == list(range(40))


def test_an_answer_that_is_lost_does_no_harm(start, server):
    lose = [1, 0, 1, 1, 0, 1]

    def script(path, body):
        if lose and lose.pop():
            server._batch(body)
            return 0, {}, {}
        return None

    server.script = script
    client = start(batch_records=7)
    send(client, 50)
    assert client.upload(wait_s=60) and times(server) == list(range(50))


def test_a_server_that_acknowledges_a_part_gets_the_rest(start, server):
    def script(path, body):
        return server._batch(body | {"records": body["records"][:2]})

    server.script = script
    client = start(batch_records=7)
    send(client, 20)
    assert client.upload(wait_s=60) and times(server) == list(range(20))


def test_a_bad_record_is_set_aside_with_a_report_and_holds_up_nothing(start, server, tmp_path):
    client = start(every_s=None)
    send(client, 10)
    client.object("x", "bad", lat=1, lon=2, time_s=10)
    send(client, 5, begin=11)
    client.object("y", "bad", lat=1, lon=2, time_s=16)
    send(client, 5, begin=17)
    assert client.upload(wait_s=60)
    assert times(server) == [*range(10), *range(11, 16), *range(17, 22)]
    aside = read_content(tmp_path / "spool").aside
    assert [(e["first"], e["count"], e["record"]["id"]) for e in aside] == [(10, 1, "x"), (16, 1, "y")]
    assert aside[0]["reason"] == "records.0.class status 422"
    client.close()
    client = start()
    send(client, 3, begin=22)
    assert client.upload(wait_s=60) and times(server)[-3:] == [22, 23, 24]


def test_a_bad_record_is_found_without_its_place(start, server, tmp_path):
    def script(path, body):
        bad = any(record["time"] in (33, 34, 70) for record in body["records"])
        return refused(400, where="json") if bad else None

    server.script = script
    client = start(every_s=None)
    send(client, 100)
    assert client.upload(wait_s=60)
    assert times(server) == [n for n in range(100) if n not in (33, 34, 70)]
    assert [entry["first"] for entry in read_content(tmp_path / "spool").aside] == [33, 34, 70]
    assert len(server.requests) < 60


def test_a_proxy_that_refuses_everything_sets_nothing_aside(start, server, tmp_path, until):
    server.script = lambda path, body: (400, {"html": "no"}, {})
    client = start()
    send(client, 10)
    until(lambda: client.status().refused)
    assert read_content(tmp_path / "spool").aside == []
    server.script = lambda path, body: None
    assert client.upload(wait_s=60) and times(server) == list(range(10))


def test_an_unknown_token_is_reported_and_nothing_is_lost(start, server, until):
    server.script = lambda path, body: refused(401)
    client = start()
    send(client, 10)
    until(lambda: client.status().refused)
    assert isinstance(client.status().refused, NotSignedIn) and client.status().online
    server.script = lambda path, body: None
    assert client.upload(wait_s=60) and times(server) == list(range(10))
    assert client.status().refused is None


@pytest.mark.parametrize("status", [429, 503])
def test_a_busy_server_is_left_alone_as_long_as_it_asks(start, server, until, status):
    answers = [refused(status, headers={"Retry-After": "1"})]
    server.script = lambda path, body: answers.pop() if answers else None
    client = start()
    begin = time.monotonic()
    send(client, 10)
    assert client.upload(wait_s=60) and times(server) == list(range(10))
    assert time.monotonic() - begin >= 1.0


def test_a_server_from_a_backup_gets_what_it_lacks(start, server):
    client = start(batch_records=5)
    send(client, 30)
    client.object("x", "bad", lat=1, lon=2, time_s=30)
    send(client, 10, begin=31)
    assert client.upload(wait_s=60)
    del server.stored()[12:]
    send(client, 5, begin=41)
    assert client.upload(wait_s=60)
    assert times(server) == [*range(30), *range(31, 46)]


def test_a_server_that_lacks_deleted_records_is_reported(start, server, until):
    client = start(limit_mb=0.03, batch_records=100)
    for begin in range(0, 800, 100):
        send(client, 100, begin=begin)
        assert client.upload(wait_s=60)
    del server.stored()[2:]
    send(client, 1)
    until(lambda: client.status().refused)
    assert isinstance(client.status().refused, Conflict)


def test_damage_that_the_server_has_already_is_no_loss(start, server, tmp_path):
    server.script = lambda path, body: server._batch(body) and (0, {}, {})  # stores, but never responds
    client = start(batch_records=5)
    send(client, 5)
    client.close(wait_s=0.2)
    assert times(server) == list(range(5))
    damage_record(tmp_path / "spool", 2)
    server.script = lambda path, body: None
    client = start()
    send(client, 5, begin=5)
    assert client.upload(wait_s=60)
    assert times(server) == list(range(10))
    assert [e for e in read_content(tmp_path / "spool").aside if e["count"]] == []


def test_photos_follow_the_records(start, server, tmp_path):
    photo = b"\xff\xd8 a photo \r\n--" * 9000
    seen = []

    def script(path, body):
        if not path.endswith("/photos"):
            return None
        seen.append(body)
        return 201, {"sha256": hashlib.sha256(photo).hexdigest()}, {}

    server.script = script
    client = start(every_s=None)
    path = tmp_path / 'left "door".jpg'
    path.write_bytes(photo)
    sha256 = client.photo(path, time_s=5.5, object_id="car 1")
    client.object("car 1", "car", lat=50, lon=14, photo=sha256)
    assert client.status().photos == 1 and not client.upload()
    assert client.upload(wait_s=60) and client.status().photos == 0
    assert sha256 == hashlib.sha256(photo).hexdigest() == server.stored()[0]["photo"]
    form = seen[0]["form"]
    assert photo in form and b'filename="left _door_.jpg"' in form
    assert b'name="time"\r\n\r\n5.5\r\n' in form and b'name="object"\r\n\r\ncar 1\r\n' in form


def test_photos_wait_on_the_disk_and_refused_ones_go_aside(start, server, tmp_path):
    client = start(every_s=None)
    good, bad = io.BytesIO(b"good"), io.BytesIO(b"bad")
    client.photo(bad, name="bad.jpg")
    client.photo(good, name="good.jpg")
    server.script = lambda path, body: (503, {}, {})
    client.close(wait_s=0.1)

    def script(path, body):
        if b"bad" in body["form"]:
            return refused(422, where="file")
        return 201, {"sha256": hashlib.sha256(b"good").hexdigest()}, {}

    server.script = script
    client = start()
    assert client.upload(wait_s=60)
    (entry,) = read_content(tmp_path / "spool").aside
    assert entry["reason"] == "file status 422"
    assert (tmp_path / "spool" / entry["photo"]).read_bytes() == b"bad"


def test_photos_that_were_not_stored_whole_are_deleted_and_damaged_ones_set_aside(start, tmp_path):
    client = start(every_s=None)
    for name in ("short.jpg", "missing.jpg", "good.jpg"):
        client.photo(io.BytesIO(name.encode()), name=name)
    client.close(wait_s=0)
    folder = tmp_path / "spool" / "data" / "photos"
    (folder / "half-stored.jpg").write_bytes(b"half")
    files = {path.name.partition("-")[2]: path for path in folder.iterdir()}
    files["short.jpg"].write_bytes(b"sh")
    files["missing.jpg"].unlink()
    client = start(every_s=None)
    assert client.status().photos == 1
    assert sorted(path.name.partition("-")[2] for path in folder.iterdir()) == ["good.jpg", "short.jpg"]
    aside = read_content(tmp_path / "spool").aside
    assert [entry["photo"].partition("-")[2] for entry in aside] == ["short.jpg", "missing.jpg"]
    assert "damaged" in aside[0]["reason"]


def test_a_full_spool_raises_at_once(start):
    client = start(every_s=None, limit_mb=0.02)
    with pytest.raises(DiskFull, match="full"):
        send(client, 1000)
    with pytest.raises(DiskFull):
        client.photo(io.BytesIO(b"x" * 2000))


def test_poses_that_hardly_moved_are_left_out_and_counted(start, server):
    client = start(min_move="0.00001deg", every_s=None)
    kept = [client.pose(50 + n * 4e-6, 14, time_s=n) for n in range(10)]
    assert [n for n, was in enumerate(kept) if was] == [0, 3, 6, 9]
    client.close()
    assert [r.get("skipped", 0) for r in server.stored()] == [0, 2, 2, 2]
    assert server.stored()[-1]["travelled_m"] == pytest.approx(9 * 4e-6 * 111229, rel=1e-3)
    client = start(min_move="0.00001deg")  # the distance continues
    client.pose(50.1, 14, time_s=10)
    client.pose(50.2, 14, time_s=11)
    assert client.upload(wait_s=60)
    assert server.stored()[-1]["travelled_m"] == pytest.approx(4.004 + 11123.9, rel=1e-4)


@pytest.mark.parametrize("url", ["maps.example.org", "ftp://maps.example.org", "http://"])
def test_an_invalid_address_is_refused(start, url):
    with pytest.raises(UsageError, match="not an address"):
        start(url=url)


def test_a_redirect_is_reported(start, server, until):
    server.script = lambda path, body: (301, {}, {"Location": "https://maps.example.org/"})
    client = start()
    send(client, 1)
    until(lambda: client.status().refused)
    assert "https://maps.example.org/" in str(client.status().refused)


def test_every_record_is_synced_where_that_is_asked(start):
    client = start(sync_s=0, every_s=None)
    database = client._spool._database
    for number in range(5):
        send(client, 1, begin=number)
        assert database._synced == database._commits
    assert database.select("PRAGMA synchronous") == [(2,)]  # FULL


def test_records_are_synced_soon_where_nothing_else_is_asked(start, until, monkeypatch):
    client = start(every_s=None)
    synced = []
    fsync = os.fsync
    monkeypatch.setattr("os.fsync", lambda descriptor: (synced.append(descriptor), fsync(descriptor)))
    send(client, 5)
    until(lambda: client._spool._database._synced == client._spool._database._commits)
    assert client._spool._database.select("PRAGMA synchronous") == [(1,)] and 1 <= len(synced) <= 5


def test_waits_double_up_to_the_longest_with_jitter():
    class Half:
        def uniform(self, low, high):
            assert (low, high) == (0.5, 1.0)
            return high

    backoff = Backoff(1, 10, rng=Half())
    assert [backoff.next_delay() for _ in range(6)] == [1, 2, 4, 8, 10, 10]
    assert backoff.next_delay(at_least_s=7) == 17
    backoff.reset()
    assert backoff.next_delay() == 1


def test_a_new_start_knows_what_is_sent_already(start, server):
    client = start()
    send(client, 3)
    client.pose(50, 14, time_s=5, source="odometry", track="left")
    client.object("car 1", "car", lat=50, lon=14, time_s=9)
    assert client.upload(wait_s=60)
    client.close()
    seen, turned, *fixes = start().recent_records()
    assert (seen["type"], seen["id"], seen["time"]) == ("object", "car 1", 9.0)
    assert (turned["source"], turned["track"], turned["time"]) == ("odometry", "left", 5.0)
    assert [(fix["time"], fix["lat"]) for fix in fixes] == [(n, 50 + n * 1e-5) for n in (2, 1, 0)]
