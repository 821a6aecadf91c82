"""Networks run side by side only where OpenCV gives each of them one thread."""

import threading
from concurrent.futures import ThreadPoolExecutor

import cv2
import pytest

from webapp.core.features.networks import Networks


@pytest.fixture
def native_threads():
    """Set how many threads OpenCV may use; as before afterwards."""
    before = cv2.getNumThreads()
    yield cv2.setNumThreads
    cv2.setNumThreads(before)


def test_with_one_native_thread_each_two_run_at_once(native_threads):
    native_threads(1)
    both = threading.Barrier(2, timeout=10)

    def run(networks):
        with networks.lent():
            both.wait()
            return True

    with ThreadPoolExecutor(2) as workers:
        assert all(workers.map(run, [Networks(object), Networks(object)]))


@pytest.mark.parametrize("way", ["lent", "renewed"])
def test_with_several_native_threads_one_runs_at_a_time_of_whatever_kind(native_threads, way):
    native_threads(2)
    inside, most = [], []

    def run(networks):
        with getattr(networks, way)():
            inside.append(networks)
            most.append(len(inside))
            threading.Event().wait(0.01)
            inside.remove(networks)

    kinds = [Networks(object), Networks(object)]
    with ThreadPoolExecutor(4) as workers:
        list(workers.map(run, kinds * 6))
    assert len(most) == 12
    assert max(most) == 1


def test_after_an_error_the_next_one_gets_its_turn(native_threads):
    native_threads(2)
    networks = Networks(object)
    with pytest.raises(ZeroDivisionError), networks.lent():
        raise ZeroDivisionError
    with networks.lent() as other:
        assert other is not None
