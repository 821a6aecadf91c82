"""`/healthz` reports problems only; `/readyz` whether requests should be sent here."""

import shutil
import sqlite3
from collections import namedtuple

import pytest

from webapp.jobs.health import Drain, ProcessLock

Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def worker(library):
    """A running worker."""
    sign = ProcessLock(library.inner / "workers")
    yield sign
    sign.release()


def test_all_is_well(stranger, worker):
    answer = stranger.get("/healthz")
    assert answer.status_code == 200
    assert answer.json == {"status": "ok", "web": "ok", "database": "ok", "disk": "ok", "worker": "ok"}


def test_the_worker_is_missing(stranger, worker):
    worker.release()
    answer = stranger.get("/healthz")
    assert answer.status_code == 503
    assert answer.json == {
        "status": "failing",
        "web": "ok",
        "database": "ok",
        "disk": "ok",
        "worker": "failing",
    }


def test_a_worker_that_was_killed_counts_as_missing(stranger, library):
    (library.inner / "workers").mkdir(exist_ok=True)
    (library.inner / "workers" / "77-abc.lock").touch()
    assert stranger.get("/healthz").json["worker"] == "failing"


def test_looking_does_not_disturb_the_worker(stranger, worker, library):
    for _ in range(3):
        assert stranger.get("/healthz").json["worker"] == "ok"
    assert not ProcessLock(library.inner / "workers").is_gone(worker.name)


def test_the_disk_is_nearly_full(stranger, worker, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: Usage(10**9, 10**9 - 10**8, 10**8))
    answer = stranger.get("/healthz")
    assert answer.status_code == 503
    assert answer.json["disk"] == "failing"


def test_the_database_is_damaged(stranger, worker, library):
    library.database.close()
    with sqlite3.connect(library.inner / "library.db") as database:
        database.execute("PRAGMA foreign_keys=OFF")
        database.execute("ALTER TABLE map RENAME TO lost")
    database.close()
    answer = stranger.get("/healthz")
    assert answer.status_code == 503
    assert answer.json["database"] == "failing"
    assert "lost" not in answer.text and "library" not in answer.text


def test_the_process_lives_whatever_fails(stranger, library):
    library.database.close()
    (library.inner / "library.db").write_bytes(b"")
    assert stranger.get("/healthz").status_code == 503
    assert (stranger.get("/livez").status_code, stranger.get("/livez").json) == (200, {"status": "ok"})


def test_a_server_that_is_going_to_stop_is_not_ready(stranger, worker, monkeypatch):
    with Drain() as drain:
        for name, value in drain.environment.items():
            monkeypatch.setenv(name, value)
        assert stranger.get("/healthz").json["status"] == "ok"
        drain.begin()
        answer = stranger.get("/healthz")
        assert (answer.status_code, answer.json["status"]) == (503, "draining")
        ready = stranger.get("/readyz")
        assert (ready.status_code, ready.json) == (503, {"status": "draining"})
        assert stranger.get("/sign-in").status_code == 200


def test_what_all_servers_share_leaves_a_server_ready(stranger, library):
    library.database.close()
    (library.inner / "library.db").write_bytes(b"")
    assert stranger.get("/healthz").status_code == 503
    assert (stranger.get("/readyz").status_code, stranger.get("/readyz").json) == (200, {"status": "ok"})
