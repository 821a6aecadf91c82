"""A library whose disk turns read-only while it is served: clear errors, reading goes on, and it recovers."""

import builtins
import errno
import io
import os
import sqlite3
import threading
import time

import pytest
from sqlalchemy import event
from sqlalchemy.exc import OperationalError

from tests.web.maps.images import png
from webapp.app.registry import REGISTRY
from webapp.errors import DatabaseUnavailable
from webapp.jobs import worker
from webapp.jobs.health import ProcessLock
from webapp.jobs.worker import Worker
from webapp.store.accounts import sign_in
from webapp.tasks.maps import adopt_map

pytestmark = pytest.mark.usefixtures("sqlite_only")

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
NAMES = ("mkdir", "rename", "replace", "unlink", "remove", "rmdir", "link", "truncate", "utime", "chmod")


@pytest.fixture
def read_only(library, monkeypatch):
    """A switch that makes the library read-only, as file systems become after an error of their disk."""
    on = [False]

    def check(path):
        if on[0] and isinstance(path, str | os.PathLike) and os.fspath(path).startswith(str(library.folder)):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), os.fspath(path))

    def guarded(real):
        def call(*paths, **named):
            for path in paths[:2]:
                check(path)
            return real(*paths, **named)

        return call

    def opened(file, mode="r", *more, **named):
        if set(mode) & set("wxa+"):
            check(file)
        return real_open(file, mode, *more, **named)

    def opened_by_system(path, flags, *more, **named):
        if flags & WRITING:
            check(path)
        return real_os_open(path, flags, *more, **named)

    def refuse(connection, _record, _proxy):
        connection.execute(f"PRAGMA query_only={int(on[0])}")

    real_open, real_os_open, real_access = io.open, os.open, os.access
    for name in NAMES:
        monkeypatch.setattr(os, name, guarded(getattr(os, name)))
    monkeypatch.setattr(os, "open", opened_by_system)
    monkeypatch.setattr(io, "open", opened)
    monkeypatch.setattr(builtins, "open", opened)
    monkeypatch.setattr(os, "access", lambda path, mode: not on[0] and real_access(path, mode))
    event.listen(library.database.engine, "checkout", refuse)
    return on


@pytest.fixture
def park(library, owner, make_map):
    """The slug of a map with three placed photos."""
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    return "park"


@pytest.fixture
def mission(client):
    return client.post("/api/v1/missions", json={"name": "Yard"}).json["id"]


PHOTO = png().getvalue()
SECRET = "a long password"
UNWRITABLE = "the file cannot be written: Read-only file system"
POSE = {"type": "pose", "time": 1.0, "lat": 50.0, "lon": 14.0}
PARK = "/api/v1/maps/park"


def photo(**more):
    return {"data": {"file": (io.BytesIO(PHOTO), "a.png"), **more}}


WRITES = {
    "edit": lambda c, _: c.patch(f"{PARK}/experiences/0", json={"x_px": 5.0, "y_px": 6.0}),
    "photo": lambda c, _: c.post(f"{PARK}/photos", **photo()),
    "localize": lambda c, _: c.post(f"{PARK}/localize", **photo()),
    "localize without keeping": lambda c, _: c.post(f"{PARK}/localize", **photo(keep="false")),
    "job": lambda c, _: c.post(f"{PARK}/exports", json={"format": "zip"}),
    "share": lambda c, _: c.post(f"{PARK}/shares", json={}),
    "batch": lambda c, id: c.post(
        f"/api/v1/missions/{id}/batches", json={"sender": "robot", "first": 0, "records": [POSE]}
    ),
    "photo of a mission": lambda c, id: c.post(f"/api/v1/missions/{id}/photos", **photo()),
    "token": lambda c, _: c.post("/api/v1/account/tokens", json={"name": "robot"}),
}


def test_writing_is_refused_and_then_works_again(app, client, park, mission, read_only):
    app.testing = False  # a bug is answered by 500
    client.get("/")  # creates the key of the sessions
    read_only[0] = True
    found = {name: write(client, mission) for name, write in WRITES.items()}
    errors = {name: errors_of(answer) for name, answer in found.items()}
    assert {name: error for name, error in errors.items() if error not in REFUSED} == {}
    read_only[0] = False
    later = {name: write(client, mission).status_code for name, write in WRITES.items()}
    assert {name: status for name, status in later.items() if status >= 500} == {}
    assert later["edit"] == later["batch"] == 200 and later["job"] == 202 and later["photo"] == 207


REFUSED = ((503, "database_unavailable", "the database is read-only"), (507, "disk_read_only", UNWRITABLE))


def errors_of(answer):
    """Return status, code and message of the error of a response, or of its only item."""
    if answer.status_code == 207:
        error = answer.json[0]["error"]
        return (507, error["code"], error["message"])
    error = answer.json.get("error", {})
    return (answer.status_code, error.get("code"), error.get("message"))


def test_nobody_can_sign_in_meanwhile(app, library, new_account, read_only):
    app.testing = False
    bob = new_account("Bob")
    with library.database.write() as session:
        session.get_one(type(bob), bob.id).password_hash = sign_in.password_hash(SECRET, minimum=10)
    fields = {"name": "Bob", "password": SECRET}
    app.test_client().post("/sign-in", data=fields)
    read_only[0] = True
    answer = app.test_client().post("/sign-in", data=fields)
    assert answer.status_code == 503 and "The database is read-only" in answer.text
    read_only[0] = False
    assert app.test_client().post("/sign-in", data=fields).status_code == 303


def test_reading_goes_on(app, client, park, mission, read_only):
    app.testing = False
    token = client.post("/api/v1/account/tokens", json={"name": "robot"}).json["token"]
    ids = [one["id"] for one in client.get(PARK).json["photos"]]
    paths = ["/", "/maps/park/settings", PARK, f"{PARK}/map.cfg", f"{PARK}/satellite", f"{PARK}/thumbnail"]
    paths += [f"{PARK}/photos/{ids[0]}/{kind}" for kind in ("thumb", "preview", "original")]
    paths += [f"{PARK}/queries", "/api/v1/jobs", f"/missions/{mission}", f"/api/v1/missions/{mission}"]
    paths += [f"/api/v1/missions/{mission}/export.csv", f"{PARK}/export.zip"]
    before = {path: client.get(path, buffered=True).status_code for path in paths}
    assert set(before.values()) == {200}
    client.patch(f"{PARK}/experiences/0", json={"x_px": 7.0, "y_px": 8.0})
    read_only[0] = True
    assert {path: client.get(path, buffered=True).status_code for path in paths} == before
    assert "0;photos/0.jpg;7;8" in client.get(f"{PARK}/map.cfg").text, "also what was not written in time"
    robot = app.test_client().get(PARK, headers={"Authorization": f"Bearer {token}"})
    assert robot.status_code == 200, "that the token was used is not noted"


def test_it_is_stated(stranger, library, read_only):
    running = ProcessLock(library.inner / "workers")
    well = {"status": "ok", "web": "ok", "database": "ok", "disk": "ok", "worker": "ok"}
    assert stranger.get("/healthz").json == well
    read_only[0] = True
    answer = stranger.get("/healthz")
    assert answer.status_code == 503
    assert answer.json == {**well, "status": "failing", "disk": "read-only"}
    ready = stranger.get("/readyz")
    assert (ready.status_code, ready.json) == (200, {"status": "ok", "disk": "read-only"})
    read_only[0] = False
    running.release()
    (library.inner / "workers" / "77-abc.lock").touch()
    read_only[0] = True
    assert stranger.get("/healthz").json["worker"] == "failing"
    read_only[0] = False
    running = ProcessLock(library.inner / "workers")
    assert stranger.get("/healthz").json == well
    assert stranger.get("/readyz").json == {"status": "ok"}
    running.release()


def test_the_worker_waits(client, library, settings, park, read_only, monkeypatch):
    monkeypatch.setattr(worker, "_DATABASE_PAUSE_S", 0.02)
    waits = threading.Event()
    real = Worker._wait_for_database

    def wait(self, error):
        waits.set()
        return real(self, error)

    monkeypatch.setattr(Worker, "_wait_for_database", wait)
    job = client.post(f"{PARK}/exports", json={"format": "zip"}).json["job"]
    made = Worker(library, settings, registry=REGISTRY)
    read_only[0] = True
    thread = threading.Thread(target=made.run)
    thread.start()
    assert waits.wait(60)
    read_only[0] = False
    until = time.monotonic() + 60
    while (state := client.get(f"/api/v1/jobs/{job}").json["state"]) != "done" and time.monotonic() < until:
        time.sleep(0.02)
    made.stop()
    thread.join(60)
    assert state == "done"


@pytest.mark.parametrize("code", ["READONLY", "READONLY_DBMOVED", "IOERR_WRITE", "IOERR_FSYNC"])
def test_what_sqlite_says_of_such_a_disk(code, library):
    reason = sqlite3.OperationalError("disk I/O error")
    reason.sqlite_errorcode = getattr(sqlite3, f"SQLITE_{code}")
    found = library.database.backend.error(OperationalError("INSERT", {}, reason), where="library.db")
    assert isinstance(found, DatabaseUnavailable) and found.message == "the database is read-only"
