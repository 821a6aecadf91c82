"""Work spread over threads keeps the order of the items and the first error."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from webapp import threads
from webapp.threads import Pool, in_threads


@pytest.mark.parametrize("cores", [1, 3])
def test_results_in_the_order_of_the_items(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    assert in_threads(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert in_threads(str, []) == []


def test_works_at_once_with_as_many_workersas_cores(monkeypatch):
    monkeypatch.setattr(threads, "cores", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    in_threads(lambda _: both.wait(), range(2))


@pytest.mark.parametrize("cores", [1, 3])
def test_the_first_error_is_raised(monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda n: 1 // n, [2, 0, 1])


def test_two_at_once_get_two_things():
    pool = Pool(object)
    both = threading.Barrier(2, timeout=10)

    def borrowed(_):
        with pool.lent() as thing:
            both.wait()
            return thing

    with ThreadPoolExecutor(2) as workers:
        a, b = workers.map(borrowed, range(2))
    assert a is not b


def test_one_after_the_other_gets_the_same_thing_in_whichever_thread():
    made = []
    pool = Pool(lambda: made.append(object()) or made[-1])

    def borrowed(_=None):
        with pool.lent() as thing:
            return thing

    first = borrowed()
    for _ in range(3):
        with ThreadPoolExecutor(1) as other:
            assert other.submit(borrowed).result() is first
    assert made == [first]


def test_what_came_back_last_is_lent_first():
    pool = Pool(object)
    with pool.lent() as outer, pool.lent() as inner:
        pass
    with pool.lent() as again:
        assert again is outer is not inner


@pytest.mark.parametrize("way", ["lent", "renewed"])
def test_what_failed_is_not_lent_again(way):
    pool = Pool(object)
    with pytest.raises(ZeroDivisionError), getattr(pool, way)() as failed:
        raise ZeroDivisionError
    with pool.lent() as other:
        assert other is not failed


def test_a_thing_can_be_made_anew_and_is_kept():
    pool = Pool(object)
    with pool.lent() as first:
        pass
    with pool.renewed() as second:
        assert second is not first
    with pool.lent() as again:
        assert again is second
