"""A library, and kinds of jobs made for the tests."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from webapp.app.registry import REGISTRY
from webapp.jobs.kinds import JobRegistry, Kind
from webapp.settings import JobSettings, Settings
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.operate import job_views, jobs

ROOT = Path(__file__).resolve().parents[2]
KINDS = {
    name: Kind(f"kinds_for_tests:{name}", short=name == "fine")
    for name in ("count", "fine", "refuse", "mistake", "lose", "away", "outlive", "stubborn", "write")
}


@pytest.fixture
def library(tmp_path, new_library):
    return new_library(tmp_path / "library")


@pytest.fixture
def settings(library, database_url):
    """Settings with short times."""
    limits = JobSettings(lease_s=60.0, stop_s=0.5, export_s=0.2)
    return replace(Settings(), library=library.folder, database=database_url, jobs=limits)


@pytest.fixture
def registry(monkeypatch):
    """All kinds of jobs, and those of `kinds_for_tests.py`."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    return JobRegistry({**REGISTRY.kinds, **KINDS}, REGISTRY.sweeps)


@pytest.fixture
def park(library):
    """Id of a map."""
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        return maps.create(session, "Park", account_id=owner.id).id


@pytest.fixture
def queue(library):
    """Queue a job and return its id."""

    def put(kind, **named):
        with library.database.write() as session:
            return jobs.enqueue(session, kind, **named).id

    return put


@pytest.fixture
def seen(library):
    """Return the job as pages get it."""

    def look(id):
        with library.database.read() as session:
            return job_views.to_json(session, jobs.find(session, id))

    return look


@pytest.fixture
def start(settings):
    """Start a worker process that knows the kinds of the tests."""
    started = []

    def run(*, lease_s=60.0, only_short=False):
        kept = ("PYTHONPATH", "EXPMAP_DATABASE")
        environ = {"PYTHONPATH": str(ROOT)} | {name: os.environ[name] for name in kept if name in os.environ}
        program = Path(__file__).with_name("kinds_for_tests.py")
        command = [sys.executable, program, settings.library, str(lease_s), *["short"] * only_short]
        process = subprocess.Popen(command, cwd=ROOT, env=environ)
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.wait()


def wait_for(happened, *, seconds=60.0):
    until = time.monotonic() + seconds
    while not (found := happened()):
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.02)
    return found


@pytest.fixture(name="wait_for")
def _wait_for():
    """Wait until something holds."""
    return wait_for
