"""The network between a machine and PostgreSQL is cut: acknowledged work is kept, and done once."""

import logging
import socket
import threading
import time
from dataclasses import replace

import pytest
from sqlalchemy import make_url

from tests.tcp_proxy import TcpProxy
from webapp.errors import DatabaseUnavailable
from webapp.jobs.worker import Worker
from webapp.store.database import announce
from webapp.store.library import open_library
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits
from webapp.store.schema import MapRecord

STEPS = 12


pytestmark = pytest.mark.usefixtures("postgresql_only")


@pytest.fixture
def network(database_url):
    """The proxy between a machine and the server."""
    proxy = TcpProxy(f"{make_url(database_url).query['host']}/.s.PGSQL.5432")
    yield proxy
    proxy.close()


@pytest.fixture
def far(library, database_url, network):
    """The library, opened by another machine through the network."""
    host, port = network.address
    url = make_url(database_url).set(host=host, port=port, query={})
    opened = open_library(library.folder, url=url.render_as_string(hide_password=False))
    yield opened
    opened.database.close()


@pytest.fixture
def at_work(far, settings, registry):
    """Start and return a worker across the network, with leases of a number of seconds."""
    started = []

    def run(*, lease_s):
        own = replace(settings, jobs=replace(settings.jobs, lease_s=lease_s))
        worker = Worker(far, own, registry=registry)
        thread = threading.Thread(target=worker.run)
        thread.start()
        started.append((worker, thread))
        return worker

    yield run
    for worker, thread in started:
        worker.stop()
        thread.join()


def test_a_change_is_refused_and_not_kept(library, far, park, network):
    with (
        pytest.raises(DatabaseUnavailable, match="the database server cannot be reached") as refused,
        far.changing(park) as change,
    ):
        change.record.name = "Lost"
        change.session.flush()
        network.cut()
    assert refused.value.wait_s > 0
    with pytest.raises(DatabaseUnavailable, match="cannot be reached"), far.database.read() as session:
        session.get(MapRecord, park)
    network.mend()
    with far.changing(park) as change:
        assert change.record.name == "Park"
        change.record.name = "StoredEvaluation"
    with library.database.read() as session:
        assert session.get_one(MapRecord, park).name == "StoredEvaluation"


def test_a_change_whose_answer_is_lost_is_refused_though_it_is_kept(library, far, park, network):
    """The client sends it again, which must be harmless."""
    network.cut_before_answer_to = b"COMMIT"
    with pytest.raises(DatabaseUnavailable, match="cannot be reached"), far.database.write() as session:
        first = jobs.enqueue(session, "fine", map_id=park).id
    with far.database.write() as session:
        assert jobs.enqueue(session, "fine", map_id=park).id == first


def test_a_job_whose_lease_could_not_be_renewed_goes_on(
    far, at_work, queue, seen, network, wait_for, library, caplog
):
    caplog.set_level(logging.INFO)
    id = queue("count", arguments={"steps": STEPS, "seconds": 0.2})
    at_work(lease_s=60.0)
    wait_for(lambda: seen(id)["done"] >= 2)
    network.cut()
    wait_for(lambda: f"the lease of job {id} was not renewed" in caplog.text)
    network.mend()
    wait_for(lambda: seen(id)["state"] == "done")
    assert seen(id)["result"] == {"steps": STEPS}
    with library.database.read() as session:
        job = jobs.find(session, id)
        assert (job.fence, job.attempts) == (1, 1)
    (said,) = {r.getMessage() for r in caplog.records if "was not renewed" in r.getMessage()}
    assert said.count("cannot be reached") == 1 and "\n" not in said


def test_a_job_that_ended_while_cut_off_is_done_when_it_can_be_said(
    at_work, queue, seen, network, wait_for, library
):
    id = queue("count", arguments={"steps": 3, "seconds": 0.2})
    at_work(lease_s=60.0)
    wait_for((library.inner / "step-0").exists)
    network.cut()
    wait_for((library.inner / "step-2").exists)
    assert seen(id)["state"] == "running"
    network.mend()
    wait_for(lambda: seen(id)["state"] == "done")
    with library.database.read() as session:
        assert jobs.find(session, id).fence == 1


def test_who_is_cut_off_for_longer_than_the_lease_keeps_nothing(
    at_work, queue, seen, network, wait_for, library, park, caplog
):
    caplog.set_level(logging.INFO)
    id = queue("write", map_id=park)
    at_work(lease_s=1.0)
    wait_for(lambda: seen(id)["state"] == "running")
    network.cut()
    limits = Limits(seconds=600.0, attempts=5)

    def taken():
        with library.database.write(locks_rows=True) as session:
            job = jobs.lease(session, "elsewhere:1:1", limits=limits)
            return job and Lease(job.id, job.fence)

    held = wait_for(taken)
    network.mend()
    (library.inner / "go").touch()
    wait_for(lambda: f"job {id} (write): taken over by another worker" in caplog.text)
    with library.database.read() as session:
        assert session.get_one(MapRecord, park).name == "Park"
        assert jobs.find(session, id).leased_by == "elsewhere:1:1"
    with library.database.write() as session:
        assert jobs.finish(session, held)


def test_a_job_whose_end_was_stored_unheard_is_done_once(
    far, at_work, queue, seen, network, wait_for, library
):
    """The worker reports the end again, and learns that it is already recorded."""
    id = queue("count", arguments={"steps": 1, "seconds": 0.0})
    real = jobs.finish

    said = []

    def unheard(session, held, **named):
        kept = real(session, held, **named)
        session.flush()
        if not said:
            network.cut_before_answer_to = b"COMMIT"
        said.append(kept)
        return kept

    with pytest.MonkeyPatch.context() as context:
        context.setattr(jobs, "finish", unheard)
        at_work(lease_s=60.0)
        wait_for(lambda: len(said) == 2)
    assert said == [True, False]
    other = queue("fine")
    wait_for(lambda: seen(other)["state"] == "done")
    with library.database.read() as session:
        assert (jobs.find(session, id).fence, jobs.find(session, id).state) == (1, "done")


def test_who_listens_hears_again(library, far, network):
    def woken(watch):
        until = time.monotonic() + 60
        while not watch.wait(0.5):
            assert time.monotonic() < until
        return True

    with far.database.watch("a", look_s=0.0) as watch:
        assert woken(watch)  # the listener is connected now
        network.cut()
        assert woken(watch), "it has to look, as something may be announced meanwhile"
        with library.database.write() as session:
            announce(session.connection(), "a")
        network.mend()
        assert woken(watch)
        while watch.wait(0.2):  # notices of the new connection and of earlier changes
            pass
        with library.database.write() as session:
            announce(session.connection(), "a")
        assert watch.wait(60)


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="this system has no TCP_USER_TIMEOUT")
def test_what_is_not_acknowledged_ends_the_connection(far):
    """Otherwise a statement sent into a cut network would block for a quarter of an hour."""
    with far.database.read() as session:
        driver = session.connection().connection.driver_connection
        with socket.fromfd(driver.fileno(), socket.AF_INET, socket.SOCK_STREAM) as own:
            milliseconds = own.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
    assert 10_000 <= milliseconds <= 30_000
