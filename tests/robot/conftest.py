"""A stand-in for the server, the real application, and options for quick tests."""

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from werkzeug.serving import make_server

from tests.robot.quick import QUICK
from tests.robot.site import Site
from tests.robot.stand_in import StandIn
from tests.robot.wire import Wire
from webapp.robot import RobotOptions


@pytest.fixture
def quick() -> Callable[..., RobotOptions]:
    """Options without long waits."""
    return lambda **more: dataclasses.replace(QUICK, **more)


@pytest.fixture
def server() -> Iterator[StandIn]:
    """A stand-in server that keeps its data in memory."""
    with StandIn() as running:
        yield running


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Wait until a condition holds, for at most a minute."""

    def wait(holds: Callable[[], object]) -> None:
        end = time.monotonic() + 60
        while not holds():
            assert time.monotonic() < end, "it never came"
            time.sleep(0.005)

    return wait


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """The application in a thread, and a proxy to it."""
    site = Site(tmp_path_factory.mktemp("served") / "library")
    http = make_server("127.0.0.1", 0, site.app, threaded=True)
    thread = threading.Thread(target=http.serve_forever, args=(0.05,))
    thread.start()
    with Wire(http.server_address) as site.wire:
        site.url = f"http://127.0.0.1:{http.port}"
        yield site
    http.shutdown()
    thread.join()
    http.server_close()
    site.library.database.close()


@pytest.fixture
def mission(site: Site) -> int:
    """The number of a new mission."""
    return site.new_mission()
