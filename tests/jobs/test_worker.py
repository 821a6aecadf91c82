"""The worker runs jobs, records their outcome, and loses none when it is stopped or killed."""

import logging
import os
import signal
import threading
import time
from dataclasses import replace

import pytest

from webapp.errors import ClusterUnavailable, DatabaseUnavailable, FolderInUse, StorageUnavailable
from webapp.jobs import worker as worker_module
from webapp.jobs.worker import Worker
from webapp.store.accounts import accounts
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Limits
from webapp.store.schema import MapRecord


@pytest.fixture(autouse=True)
def end_of_threads(library):
    """Wait for threads of a worker in this process before the library is closed."""
    yield
    for thread in threading.enumerate():
        if thread.name in ("export", "store", "watch"):
            thread.join(60)
            assert not thread.is_alive()


@pytest.fixture
def work(library, settings, registry):
    """Run all queued jobs in this process."""
    return lambda: Worker(library, settings, registry=registry).run(once=True)


def steps(library):
    return len(list(library.inner.glob("step-*")))


def test_jobs_are_done_in_turn(work, queue, seen, park):
    ids = [queue("fine", map_id=park), queue("fine")]
    work()
    assert [seen(id)["state"] for id in ids] == ["done", "done"]
    assert [seen(id)["result"] for id in ids] == [{"map": park}, {"map": None}]


def test_a_job_that_cannot_be_done_says_why(work, queue, seen, caplog):
    refused, wrong, unknown, last = (queue(kind) for kind in ("refuse", "mistake", "unheard-of", "fine"))
    with caplog.at_level(logging.INFO):
        work()
    assert seen(refused)["error"] == {
        "message": "the disk is full",
        "where": "here",
        "hint": "free some space",
    }
    assert seen(wrong)["error"]["message"] == f"internal error in job {wrong}"
    assert "ZeroDivisionError" in caplog.text
    assert "unheard-of" in seen(unknown)["error"]["message"]
    for id in (refused, wrong, unknown):
        assert seen(id)["state"] == "failed"
        assert seen(id)["done"] < seen(id)["total"]
    assert seen(last)["state"] == "done"


def test_the_thread_that_keeps_the_storage_in_order_outlives_its_errors(
    library, settings, registry, monkeypatch, caplog
):
    worker, rounds = Worker(library, settings, registry=registry), []

    def fail(_library, *, stops):
        rounds.append(stops())
        if len(rounds) > 2:
            worker.stop()
        raise (StorageUnavailable("it is away", wait_s=1) if len(rounds) == 2 else ZeroDivisionError)

    monkeypatch.setattr(worker_module, "_CLEAN_S", 0.01)
    monkeypatch.setattr(worker_module.maintain_objects, "move_photos", fail)
    worker.run()
    assert len(rounds) >= 3
    told = [one for one in caplog.records if "object storage could not be kept in order" in one.getMessage()]
    assert [one.levelname for one in told[:2]] == ["ERROR", "WARNING"]
    assert told[0].exc_info and "it is away" in told[1].getMessage() and not told[1].exc_info


def test_a_job_that_lost_a_process_continues_but_not_for_ever(work, queue, seen, settings):
    id = queue("lose", arguments={"times": 2})
    work()
    assert (seen(id)["state"], seen(id)["result"]) == ("done", {"tries": 3})
    hopeless = queue("lose", arguments={"times": 1000})
    work()
    assert seen(hopeless)["state"] == "failed"
    assert f"died {settings.jobs.attempts} times" in seen(hopeless)["error"]["message"]


def test_while_storage_is_away_other_jobs_are_done(library, settings, registry, queue, seen, wait_for):
    """The pause of a job does not pause the worker: the pause is longer than this test."""
    waiting = [queue("away", key=str(n), arguments={"wait_s": 600}) for n in range(3)]
    worker = Worker(library, settings, registry=registry)
    working = threading.Thread(target=worker.run)
    working.start()
    try:
        wait_for(lambda: all(seen(id)["note"] for id in waiting))
        other = queue("fine")
        wait_for(lambda: seen(other)["state"] == "done")
    finally:
        worker.stop()
        working.join()
    assert {seen(id)["state"] for id in waiting} == {"queued"}
    with library.database.read() as session:
        assert [(jobs.find(session, id).fence, jobs.find(session, id).attempts) for id in waiting] == [
            (1, 0)
        ] * 3


@pytest.mark.parametrize("error", [StorageUnavailable, DatabaseUnavailable, ClusterUnavailable, FolderInUse])
def test_what_waits_is_no_failure_and_once_does_it_when_what_was_away_is_back(
    library, work, queue, seen, error
):
    id = queue("away", arguments={"error": error.__name__, "wait_s": 600})
    with pytest.raises(error, match="cannot be reached"):
        work()
    assert (seen(id)["state"], seen(id)["note"]) == ("queued", "it cannot be reached")
    with library.database.read() as session:
        assert jobs.find(session, id).attempts == 0, "nobody died"
    (library.inner / "back").touch()
    work()
    assert seen(id)["state"] == "done"


def test_progress_is_seen_and_cancel_heard(library, start, queue, seen, wait_for):
    id = queue("count", arguments={"steps": 400, "seconds": 0.05})
    start()
    wait_for(lambda: seen(id)["done"] >= 3)
    running = seen(id)
    assert (running["state"], running["total"]) == ("running", 400)
    assert running["note"].startswith("step-")
    assert 0 < running["seconds_left"] < 600
    with library.database.write() as session:
        jobs.cancel(session, jobs.find(session, id))
    wait_for(lambda: seen(id)["state"] == "cancelled")
    assert 3 <= seen(id)["done"] < 400
    kept = steps(library)
    assert 3 <= kept < 400
    with library.database.write() as session:
        jobs.retry(session, jobs.find(session, id)).arguments = {"steps": kept + 2, "seconds": 0.0}
    wait_for(lambda: seen(id)["state"] == "done")
    assert seen(id)["result"] == {"steps": 2}


def test_after_kill_9_another_worker_continues_at_once(library, start, queue, seen, wait_for):
    id = queue("count", arguments={"steps": 12, "seconds": 0.25})
    first, second = start(lease_s=600.0), start(lease_s=600.0)  # a lease too long to expire during the test
    wait_for(lambda: steps(library) >= 2)
    with library.database.read() as session:
        holder = jobs.find(session, id).leased_by
    killed = first if f":{first.pid}:" in holder else second
    killed.kill()
    wait_for(lambda: seen(id)["state"] == "running" and seen(id)["total"] < 12)
    wait_for(lambda: seen(id)["state"] == "done")
    assert seen(id)["result"]["steps"] < 12
    assert steps(library) == 12


def test_a_job_that_goes_on_shows_how_long_the_rest_takes(library, start, queue, seen, wait_for):
    id = queue("count", arguments={"steps": 400, "seconds": 0.2})
    killed = start(lease_s=600.0)
    wait_for(lambda: steps(library) >= 8)
    killed.kill()
    killed.wait()
    start(lease_s=600.0)
    wait_for(lambda: seen(id)["state"] == "running" and seen(id)["total"] < 400 and seen(id)["done"] >= 1)
    now = seen(id)
    assert now["seconds_left"] >= 0.2 * (now["total"] - now["done"])  # what was done before is not its pace
    assert now["seconds_left"] <= 60 * (now["total"] - now["done"])


def test_two_workers_do_each_step_once(library, start, queue, seen, wait_for):
    ids = [queue("count", key=str(n), arguments={"steps": 0}) for n in range(6)]
    start(), start()
    wait_for(lambda: all(seen(id)["state"] == "done" for id in ids))
    with library.database.read() as session:
        assert [jobs.find(session, id).attempts for id in ids] == [1] * 6


def test_a_lock_that_is_never_freed_fails_a_job_in_the_end(library, work, queue, seen):
    id = queue("away", arguments={"error": "FolderInUse", "wait_s": 600})
    with library.database.write() as session:
        jobs.find(session, id).waits = worker_module._MOST_WAITS - 1
    with pytest.raises(FolderInUse):
        work()
    assert seen(id)["state"] == "queued"
    with pytest.raises(FolderInUse):
        work()
    assert (seen(id)["state"], seen(id)["error"]["message"]) == ("failed", "it cannot be reached")


def test_stopped_it_gives_the_job_back(library, start, queue, seen, wait_for):
    id = queue("count", arguments={"steps": 2000, "seconds": 0.02})
    worker = start()
    wait_for(lambda: steps(library) >= 2)
    worker.send_signal(signal.SIGTERM)
    assert worker.wait(60) == 0
    assert seen(id)["state"] == "queued"
    with library.database.read() as session:
        assert jobs.find(session, id).attempts == 0
    assert not list((library.inner / "workers").iterdir())


def test_stopped_in_a_long_step_it_ends_all_the_same(library, start, queue, seen, wait_for):
    id = queue("stubborn", arguments={"seconds": 600})
    worker = start()
    wait_for((library.inner / "begun").exists)
    worker.send_signal(signal.SIGINT)
    assert worker.wait(60) == 0
    assert seen(id)["state"] == "queued"


def test_stopped_in_a_long_step_without_a_database_it_ends_all_the_same(
    library, settings, registry, queue, monkeypatch
):
    def ended(code):
        raise SystemExit(code)

    def away(**_):
        raise DatabaseUnavailable("the database server cannot be reached", wait_s=1)

    monkeypatch.setattr(os, "_exit", ended)
    queue("stubborn", arguments={"seconds": 2})
    worker = Worker(library, replace(settings, jobs=replace(settings.jobs, stop_s=0.0)), registry=registry)

    def stop_when_begun():
        begun = (library.inner / "begun").exists()
        if begun:
            monkeypatch.setattr(library.database, "write", away)
            worker.stop()
        return begun

    monkeypatch.setattr(worker, "_stops", stop_when_begun)
    with pytest.raises(SystemExit) as left:
        worker.run()
    assert left.value.code == 0


def test_short_jobs_start_within_three_seconds_beside_a_long_one(library, start, queue, seen, park, wait_for):
    """Both processes of a worker, also after the one for short jobs was killed with a job."""
    long = queue("count", map_id=park, arguments={"steps": 2000, "seconds": 0.02})
    start()
    wait_for(lambda: seen(long)["state"] == "running")
    short = start(only_short=True)
    first = queue("fine", map_id=park)
    wait_for(lambda: seen(first)["state"] == "done")
    begun = time.monotonic()
    for n in range(3):
        id = queue("fine", map_id=park, key=str(n))
        wait_for(lambda id=id: seen(id)["state"] == "done")
    assert time.monotonic() - begun < 3 * 3
    short.kill()
    short.wait()
    waiting = queue("fine", map_id=park, key="after")
    start(only_short=True)
    wait_for(lambda: seen(waiting)["state"] == "done")
    assert seen(long)["state"] == "running" and steps(library) < 2000


def test_a_job_in_the_background_makes_room_and_continues_where_it_was(library, start, queue, seen, wait_for):
    with library.database.write() as session:
        ana = accounts.ensure_owner(session).id
    background = queue("count", arguments={"steps": 150, "seconds": 0.05})
    start()
    wait_for(lambda: steps(library) >= 2)
    asked = queue("count", account_id=ana, key="asked", arguments={"steps": 0})
    wait_for(lambda: seen(asked)["state"] == "done")
    assert steps(library) < 150
    wait_for(lambda: seen(background)["state"] == "done")
    assert seen(background)["result"]["steps"] < 150, "what was done was kept"


def test_who_is_stopped_for_long_keeps_nothing_of_what_it_does_then(
    library, start, queue, seen, park, wait_for
):
    id = queue("write", map_id=park)
    worker = start(lease_s=2.0)
    wait_for(lambda: seen(id)["state"] == "running")
    worker.send_signal(signal.SIGSTOP)
    limits = Limits(seconds=600.0, attempts=5)

    def taken():
        with library.database.write() as session:
            return jobs.lease(session, "elsewhere:1:1", limits=limits)

    wait_for(taken)
    (library.inner / "go").touch()
    worker.send_signal(signal.SIGCONT)
    wait_for((library.inner / "tried").exists)
    assert seen(id)["state"] == "running"
    with library.database.read() as session:
        assert session.get(MapRecord, park).name == "Park"
        assert jobs.find(session, id).leased_by == "elsewhere:1:1"


def test_a_deleted_map_ends_its_job(library, start, queue, park, wait_for):
    queue("count", map_id=park, arguments={"steps": 2000, "seconds": 0.02})
    start()
    wait_for(lambda: steps(library) >= 1)
    with library.database.write() as session:
        session.delete(session.get(MapRecord, park))
    next_one = queue("count", key="next", arguments={"steps": 0})
    wait_for(lambda: _state(library, next_one) == "done")
    assert steps(library) < 2000


def _state(library, id):
    with library.database.read() as session:
        return jobs.find(session, id).state
