"""A stand-in for the server, and options for quick tests."""

import dataclasses
import time
from collections.abc import Callable, Iterator

import pytest

from tests.robot.stand_in import StandIn
from webapp.robot import RobotOptions

QUICK = RobotOptions(sync_s=0.01, every_s=0.02, timeout_s=2.0, backoff_s=0.01, backoff_max_s=0.05)


@pytest.fixture
def quick() -> Callable[..., RobotOptions]:
    """Options without long waits."""
    return lambda **more: dataclasses.replace(QUICK, **more)


@pytest.fixture
def server() -> Iterator[StandIn]:
    """A server of the right kind, without a disk."""
    with StandIn() as running:
        yield running


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Wait until something holds, for ten seconds."""

    def wait(holds: Callable[[], object]) -> None:
        end = time.monotonic() + 10
        while not holds():
            assert time.monotonic() < end, "it never came"
            time.sleep(0.005)

    return wait
