"""Local work in many parts: results in order, a few in parallel, with cancellation and errors."""

import os
import signal
import threading
import time

import pytest

from webapp.errors import Cancelled, ProcessLost
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.computing import local
from webapp.tasks.computing.in_order import ExecutionTarget, in_order


def twice(factor, number):
    if number == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.002 * (number % 3))
    return factor * number


class Stopped(Progress):
    def __init__(self):
        self.wanted = False

    def cancelled(self):
        return self.wanted


@pytest.mark.parametrize("here", ["inline", "threads", "processes"])
def test_results_are_in_order(tmp_path, here):
    at = ExecutionTarget(Settings(), tmp_path, here, 2)
    assert [*in_order(twice, range(13), shared=2, at=at, progress=Progress())] == [*range(0, 26, 2)]
    assert [*in_order(twice, [], shared=2, at=at, progress=Progress())] == []
    assert not any(thread.name.startswith("ThreadPool") for thread in threading.enumerate())


def test_few_items_are_taken_ahead(tmp_path):
    taken = []
    items = (taken.append(n) or n for n in range(100))
    found = in_order(
        twice, items, shared=1, at=ExecutionTarget(Settings(), tmp_path, "threads", 2), progress=Progress()
    )
    assert next(found) == 0
    assert len(taken) <= 9
    found.close()


def test_fewer_at_once_than_are_waiting(tmp_path, monkeypatch):
    class Shrinking(local.Inline):
        @property
        def at_once(self):
            return next(sizes, 1)

    sizes = iter([8, 2, 2, 8, 1])
    monkeypatch.setattr(local, "Inline", Shrinking)
    at = ExecutionTarget(Settings(), tmp_path)
    assert [*in_order(twice, range(12), shared=1, at=at, progress=Progress())] == [*range(12)]


@pytest.mark.parametrize("here", ["inline", "threads"])
def test_it_stops(tmp_path, here):
    progress = Stopped()
    done = []
    with pytest.raises(Cancelled):
        for result in in_order(
            twice, [1] * 100, shared=1, at=ExecutionTarget(Settings(), tmp_path, here, 2), progress=progress
        ):
            done.append(result)
            progress.wanted = len(done) >= 5
    assert 5 <= len(done) < 20


@pytest.mark.skipif(os.name == "nt", reason="processes are killed otherwise there")
def test_a_killed_process_is_reported(tmp_path):
    at = ExecutionTarget(Settings(), tmp_path, "processes", 2)
    with pytest.raises(ProcessLost, match="a worker process was killed"):
        [*in_order(twice, [1, 13, 2], shared=1, at=at, progress=Progress())]
