"""Fixtures: a small map, and nodes that communicate on this machine only."""

import json
import os
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path

from ros.run_tests import DOMAINS

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if worker := os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw"):
    # separate domains, since nodes of one test process would receive messages of another
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0")) + DOMAINS * int(worker)
    os.environ["ROS_DOMAIN_ID"] = str(domain)
# Shells ignore SIGINT in background processes, and the nodes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

import cv2
import numpy as np
import pytest

with warnings.catch_warnings():  # raised by the message parser in the wheels
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_parser.parser  # noqa: F401

from ros.expmap_ros.test.support import LAT, LON, PLACES, Bench, textured
from tests.robot.stand_in import StandIn


def pytest_configure(config: pytest.Config) -> None:
    """Ignore a deprecated call in rclpy, with which it warns about nodes of an earlier test."""
    config.addinivalue_line(
        "filterwarnings", "ignore:Deprecated in favor of .*RcutilsLogger.warning:DeprecationWarning"
    )


@pytest.fixture(scope="session")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a map of six photos in a row, 100 pixels or about 7 m apart, with the photos."""
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
    """Provide nodes, and one that listens to them."""
    made = Bench()
    yield made
    made.close()


@pytest.fixture
def server() -> Iterator[StandIn]:
    """Run a server that stores what it receives."""
    with StandIn() as running:
        yield running


@pytest.fixture
def values(server: StandIn, tmp_path: Path) -> dict[str, object]:
    """Return the parameters of a mission_bridge."""
    (tmp_path / "token").write_text("secret")
    return {
        "server_url": server.url,
        "token_file": str(tmp_path / "token"),
        "mission": 7,
        "spool": str(tmp_path / "spool"),
    }
