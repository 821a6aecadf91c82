"""Work spread over threads keeps the order of the items and the first error."""

import threading
from threading import Semaphore

import pytest

from webapp import threads
from webapp.errors import Busy
from webapp.threads import in_threads, permit


@pytest.mark.parametrize("cores", [1, 3])
def test_results_in_the_order_of_the_items(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    assert in_threads(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert in_threads(str, []) == []


def test_works_at_once_with_as_many_workersas_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    both = threading.Barrier(2, timeout=60)
    in_threads(lambda _: both.wait(), range(2))


@pytest.mark.parametrize("cores", [1, 3])
def test_the_first_error_is_raised(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [2, 0, 1])


def test_who_waits_for_a_permit_is_told_that_others_are_busy():
    semaphore = Semaphore(1)
    with permit(semaphore), pytest.raises(Busy) as caught, permit(semaphore, wait_s=0.01):
        pass
    assert caught.value.wait_s > 0
    with permit(semaphore, wait_s=0.01):
        pass
