"""Jobs of a library that are computed by Dask: cancelled from a page, and with photos in S3."""

import os
import shutil
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cluster import slow_job
from tests.cluster.dask_cluster import DaskCluster
from tests.web.conftest import Browser
from webapp.app.registry import REGISTRY
from webapp.app.web import create_app
from webapp.extras import is_installed
from webapp.files import contents
from webapp.jobs.kinds import JobRegistry, Kind
from webapp.jobs.worker import Worker
from webapp.store.accounts import accounts
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.maps import adopt_map
from webapp.tasks.operate import maintain_objects, open_storage

pytestmark = pytest.mark.skipif(
    not is_installed("cluster") or os.name == "nt", reason="the extra `cluster` is not installed"
)
LASTING = (".features", ".ivf", ".codebook")


@contextmanager
def cluster(folder: Path):
    """A scheduler with two workers, with the present environment."""
    started = DaskCluster(folder, workers=2)
    try:
        started.wait(2)
        yield started
    finally:
        started.stop()


@contextmanager
def working(worker: Worker):
    """A running worker."""
    thread = threading.Thread(target=worker.run)
    thread.start()
    try:
        yield
    finally:
        worker.stop()
        thread.join()


def wait_until(holds, seconds=60.0):
    until = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.05)


def test_a_job_is_cancelled_from_a_page_and_the_workers_are_free(tmp_path, new_library, quick, database_url):
    from distributed import Client

    library = new_library(tmp_path / "library")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        id = jobs.enqueue(session, "slow", account_id=owner.id).id
    settings = replace(quick, library=library.folder, database=database_url)
    app = create_app(settings, library=library)
    app.testing, app.test_client_class = True, Browser
    page = app.test_client()
    with page.session_transaction() as cookie:
        cookie.update(_user_id=f"{owner.id}.{owner.epoch}", session_id="0" * 32)
    own = JobRegistry({**REGISTRY.kinds, "slow": Kind("tests.cluster.slow_job:compute")}, REGISTRY.sweeps)
    begun = lambda: len([*library.inner.glob("part-*")])  # noqa: E731
    with (
        cluster(tmp_path) as dask,
        Client(dask.address, set_as_default=False) as client,
        working(Worker(library, replace(settings, dask=dask.address), registry=own)),
    ):
        wait_until(lambda: page.get(f"/api/v1/jobs/{id}").get_json()["done"] >= 2)
        assert page.post(f"/api/v1/jobs/{id}/cancel").status_code == 200
        wait_until(lambda: page.get(f"/api/v1/jobs/{id}").get_json()["state"] == "cancelled")
        wait_until(lambda: client.run_on_scheduler(tasks) == 0)
        kept = begun()
        assert kept < slow_job.PARTS / 2, "else it had not been cancelled, but done"
        assert [*client.processing().values()] == [(), ()]
        assert client.submit(max, [1, 2]).result(timeout=30) == 2, "the workers do what comes next"
        assert begun() == kept
    assert not [*library.inner.glob(".computing-*")]


def tasks(dask_scheduler):
    """Count the tasks of the scheduler."""
    return len(dask_scheduler.tasks)


@pytest.fixture
def on_postgresql(postgresql):
    """Address of a database: SQLite does not support object storage."""
    url = postgresql.new_database(empty=True)
    yield url
    postgresql.drop(url)


def test_photos_in_s3_give_the_same_bytes(tmp_path, make_map, quick, s3, on_postgresql):
    from webapp.store.library import open_library

    library = open_library(tmp_path / "library", url=on_postgresql)
    here = replace(quick, library=library.folder, database=on_postgresql)
    folder = library.map_folder("row")
    make_map(folder, 12)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    id = adopt_map.adopt_map(library, "row", account_id=owner.id)
    Worker(library, here, registry=REGISTRY).run(once=True)
    local = {path: path.read_bytes() for path in folder.glob("derived/map/*/*") if path.suffix in LASTING}
    assert len(local) == 3
    shutil.rmtree(folder / "derived/map")
    there = replace(here, storage=f"s3://{s3.new_bucket()}/lib", cache_folder=tmp_path / "cache")
    try:
        open_storage.open_storage(library, there)
        assert maintain_objects.move_photos(library) == 12 + 1, "the photos and the image"
        for photo in folder.glob("photos/[!.]*"):
            photo.unlink()
        with cluster(tmp_path) as dask:
            with library.database.write() as session:
                job = jobs.enqueue(session, "index", map_id=id).id
            Worker(library, replace(there, dask=dask.address), registry=REGISTRY).run(once=True)
        with library.database.read() as session:
            done = session.get_one(Job, job)
        assert (done.state, done.error) == ("done", None)
        assert done.result["computed"] == 12
        for path, data in local.items():
            assert not path.exists(), "it is in S3"
            assert contents.local(path).read_bytes() == data
    finally:
        contents.use(None)
        library.database.close()
