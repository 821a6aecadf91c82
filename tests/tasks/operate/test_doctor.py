"""What is wrong with an installation or a library is named, with what to do; nothing is changed."""

import hashlib
import json
import os
import shutil
import socket
import sqlite3
import threading
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from webapp.jobs.health import ProcessLock
from webapp.settings import PhotoLimits, Settings, UploadLimits, WebSettings
from webapp.store.accounts import accounts
from webapp.store.clock import now
from webapp.store.library import open_library
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.maps import adopt_map
from webapp.tasks.operate import doctor


@pytest.fixture
def library(tmp_path, make_map):
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    with library.database.write() as session:
        session.query(Job).delete()
    yield library
    library.database.close()


@pytest.fixture
def settings(library):
    return replace(Settings(), library=library.folder)


def states(checks):
    """The checks by name, the worst of each name."""
    found = {}
    for check in sorted(checks, key=lambda check: ("ok", "warning", "failing").index(check.state)):
        found[check.name] = check
    return found


def content(folder):
    return {
        path: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in (".db-shm", ".db-wal")
    }


def test_a_sound_library(settings, library):
    library.database.close()
    before = content(library.folder)
    found = states(doctor.check_library(settings))
    assert {check.state for check in found.values()} == {"ok"}, found
    assert {"library", "permissions", "disk", "database", "clock", "jobs", "maps"} <= found.keys()
    assert "intact" in found["database"].message and found["maps"].message == "1, each with its folder"
    assert content(library.folder) == before


def test_this_installation(settings):
    found = states(doctor.check_installation(settings))
    assert found["python"].state == found["packages"].state == found["machine"].state == "ok"
    assert "numpy" in found["packages"].message


def test_no_library_is_made(tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        found = states(doctor.check_library(replace(Settings(), library=folder)))
        assert found.keys() == {"library"} and "serve" in found["library"].hint
    assert list(tmp_path.iterdir()) == []


def test_a_library_of_an_older_version_is_not_migrated(settings, library):
    file = library.inner / "library.db"
    library.database.close()
    with closing(sqlite3.connect(file)) as raw:
        raw.execute("UPDATE alembic_version SET version_num = '0007'")
        raw.commit()
    check = states(doctor.check_library(settings))["database"]
    assert check.state == "warning" and "0007" in check.message and "backup" in check.hint
    with closing(sqlite3.connect(file)) as raw:
        assert raw.execute("SELECT version_num FROM alembic_version").fetchone() == ("0007",)


def test_a_damaged_database(settings, library):
    library.database.close()
    file = library.inner / "library.db"
    data = bytearray(file.read_bytes())
    data[8192 : len(data) // 2] = os.urandom(len(data) // 2 - 8192)
    file.write_bytes(data)
    check = states(doctor.check_library(settings))["database"]
    assert check.state == "failing"


def test_a_map_without_its_folder(settings, library):
    shutil.rmtree(library.map_folder("park"))
    check = states(doctor.check_library(settings))["maps"]
    assert check.state == "failing" and "park" in check.message


def test_a_full_disk(settings):
    most = UploadLimits(reserve_mb=1e12)
    check = states(doctor.check_library(replace(settings, upload=most)))["disk"]
    assert check.state == "failing" and "reserve" in check.message


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_a_key_that_others_can_read(settings, library):
    key = library.inner / "secret-key"
    key.write_text("x")
    library.inner.chmod(0o755)
    key.chmod(0o644)
    assert "chmod 600" in states(doctor.check_library(settings))["permissions"].hint
    key.chmod(0o600)
    assert states(doctor.check_library(settings))["permissions"].state == "ok"


def test_jobs_that_nobody_does(settings, library):
    with library.database.write() as session:
        job = jobs.enqueue(session, "index")
    check = states(doctor.check_library(settings))["jobs"]
    assert check.state == "warning" and "no worker" in check.message
    with library.database.write() as session:
        session.get(Job, job.id).created_at = now() - timedelta(hours=1)
    lock = ProcessLock(library.inner / "workers")
    try:
        check = states(doctor.check_library(settings))["jobs"]
        assert check.state == "warning" and "60 minutes" in check.message
    finally:
        lock.release()


def test_a_clock_that_was_set_back(settings, library):
    with library.database.write() as session:
        jobs.enqueue(session, "index").created_at = now() + timedelta(hours=1)
    check = states(doctor.check_library(settings))["clock"]
    assert check.state == "warning" and "set back" in check.message


@pytest.mark.parametrize(
    ("line", "state"),
    [("server:/x {} nfs4 rw 0 0", "failing"), ("/dev/sda1 {} ext4 rw 0 0", "ok")],
)
def test_a_database_on_a_disk_in_the_network(settings, library, tmp_path, monkeypatch, line, state):
    mounts = tmp_path / "mounts"
    mounts.write_text("/dev/sda2 / ext4 rw 0 0\n" + line.format(library.folder) + "\n")
    kind = doctor._kind_of_disk
    monkeypatch.setattr(doctor, "_kind_of_disk", lambda folder: kind(folder, mounts))
    assert states(doctor.check_library(settings))["file system"].state == state


def test_too_little_memory_for_the_largest_photos(settings):
    check = states(doctor.check_installation(replace(settings, photo=PhotoLimits(max_megapixels=1e6))))
    assert check["machine"].state == "warning" and "photo.max_megapixels" in check["machine"].hint


def test_an_outgoing_proxy_is_named(settings, monkeypatch):
    monkeypatch.setenv("HTTPS_PROXY", "http://proxy:3128")
    monkeypatch.setenv("NO_PROXY", "localhost")
    message = states(doctor.check_installation(settings))["outgoing proxy"].message
    assert message.startswith("for https: ") and "3128" not in message, "an address may have a password"


def test_ports(settings):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        check = states(doctor.check_address("127.0.0.1", port, settings=settings))["port"]
        assert check.state == "failing" and "another program" in check.hint
    assert states(doctor.check_address("127.0.0.1", port, settings=settings))["port"].state == "ok"
    assert states(doctor.check_address("192.0.2.1", port, settings=settings))["port"].state == "failing"


@pytest.mark.parametrize("state", ["ok", "failing"])
def test_a_server_that_answers(settings, state):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            body = json.dumps({"status": state, "database": state}).encode()
            self.send_response(200 if state == "ok" else 503)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        found = states(doctor.check_address("127.0.0.1", server.server_port, settings=settings))
        server.shutdown()
    assert found["server"].state == state
    if state == "failing":
        assert "database" in found["server"].message


def test_pages_without_encryption(settings):
    assert states(doctor.check_address("0.0.0.0", 8123, settings=settings))["https"].state == "warning"
    behind = replace(settings, web=WebSettings(proxies=1))
    assert "https" not in states(doctor.check_address("0.0.0.0", 8123, settings=behind))
