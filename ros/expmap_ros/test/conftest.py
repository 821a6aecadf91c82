"""A small map, and nodes on this machine alone."""

import json
import os
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path

from ros.run_tests import DOMAINS

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if worker := os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw"):
    # Nodes of one test process would answer those of another.
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0")) + DOMAINS * int(worker)
    os.environ["ROS_DOMAIN_ID"] = str(domain)
# A shell starts what runs in the background without the interrupt, and the nodes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

import cv2
import numpy as np
import pytest

with warnings.catch_warnings():  # of the parser of messages, in the wheels
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_parser.parser  # noqa: F401

from ros.expmap_ros.test.support import LAT, LON, PLACES, Bench, textured
from tests.robot.stand_in import StandIn


def pytest_configure(config: pytest.Config) -> None:
    """Let rclpy use its own deprecated call, by which it warns of nodes of an earlier test."""
    config.addinivalue_line(
        "filterwarnings", "ignore:Deprecated in favor of .*RcutilsLogger.warning:DeprecationWarning"
    )


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of six photos in a row, 100 pixels or some 7 m apart, and its photos."""
    from webapp.api import GeoSource, PlaceOptions, place_photos

    folder = tmp_path_factory.mktemp("survey")
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 700, 3), 200, np.uint8))
    corners = {
        "top_left": {"lat": LAT, "lon": LON},
        "bottom_right": {"lat": LAT - 0.000126, "lon": LON + 0.000686},
    }
    (folder / "corners.json").write_text(json.dumps(corners))
    rows = ["name;x;y"]
    (folder / "photos").mkdir()
    for number, (x, y) in enumerate(PLACES):
        cv2.imwrite(str(folder / "photos" / f"{number}.jpg"), textured(number))
        rows.append(f"{number}.jpg;{x};{y}")
    (folder / "positions.csv").write_text("\n".join(rows) + "\n")
    source = GeoSource("corners", folder / "corners.json")
    options = PlaceOptions(
        folder / "map.cfg", folder / "plan.png", source=source, positions=folder / "positions.csv"
    )
    place_photos(folder / "photos", options)
    return folder


@pytest.fixture
def bench() -> Iterator[Bench]:
    """Nodes and a listener."""
    made = Bench()
    yield made
    made.close()


@pytest.fixture
def server() -> Iterator[StandIn]:
    """A server that keeps what it is sent."""
    with StandIn() as running:
        yield running


@pytest.fixture
def values(server: StandIn, tmp_path: Path) -> dict[str, object]:
    """Parameters of a mission_bridge."""
    (tmp_path / "token").write_text("secret")
    return {
        "server_url": server.url,
        "token_file": str(tmp_path / "token"),
        "mission": 7,
        "spool": str(tmp_path / "spool"),
    }
