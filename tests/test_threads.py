"""Work spread over threads keeps the order of the items and the first error."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from webapp import threads
from webapp.threads import OnePerThread, in_threads


@pytest.mark.parametrize("cores", [1, 3])
def test_results_in_the_order_of_the_items(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    assert in_threads(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert in_threads(str, []) == []


def test_works_at_once_with_as_many_threads_as_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    in_threads(lambda _: both.wait(), range(2))


@pytest.mark.parametrize("cores", [1, 3])
def test_the_first_error_is_raised(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [2, 0, 1])


def test_each_thread_has_its_own_thing_and_keeps_it():
    made = OnePerThread(object)
    both = threading.Barrier(2, timeout=10)

    def twice():
        first = made.get()
        both.wait()
        return first, made.get()

    with ThreadPoolExecutor(2) as pool:
        (a, again), (b, b_again) = (run.result() for run in [pool.submit(twice), pool.submit(twice)])
    assert a is again
    assert b is b_again
    assert a is not b


def test_a_thing_can_be_made_anew():
    made = OnePerThread(object)
    first = made.get()
    second = made.renew()
    assert second is not first
    assert made.get() is second
