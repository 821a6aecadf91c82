"""The robot's frame on the Earth, compared with the formula of 2012."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.core.trajectory.robotframe import Anchor, LocalPoses, RobotFrame, Start, anchor_of

GEOD = Geod(ellps="WGS84")
A_M, B_M = 6_378_137.0, 6_356_752.314
DOCS = Path(__file__).resolve().parents[3] / "docs" / "track-files.md"


def formula_2012(start: LatLon, xy_m: np.ndarray) -> np.ndarray:
    """Return latitude and longitude of a robot that started facing east, as computed by the first system."""
    x, y = xy_m.T
    lat = start.lat + np.degrees(y / B_M)
    lon = start.lon + np.degrees(x / (A_M * math.cos(math.radians(start.lat))))
    return np.column_stack([lat, lon])


def off_share(lat: float, metres: float) -> float:
    """Return the error of the formula relative to the distance, for the worst direction."""
    start = LatLon(lat, 14.0)
    angles = np.radians(np.arange(0.0, 360.0, 5.0))
    xy = metres * np.column_stack([np.cos(angles), np.sin(angles)])
    true = RobotFrame(Start(start, 90.0)).latlon_from_xy(xy)
    wrong = formula_2012(start, xy)
    beyond = np.abs(wrong[:, 0]) > 90.0
    wrong[beyond] = (np.nan, np.nan)
    off = GEOD.inv(true[:, 1], true[:, 0], wrong[:, 1], wrong[:, 0])[2]
    return math.inf if beyond.any() else float(np.max(off)) / metres


@pytest.mark.parametrize("lat", [-60.0, 0.0, 42.4, 50.0, 60.0])
def test_the_formula_holds_near_the_start(lat: float) -> None:
    assert off_share(lat, 100.0) < 0.01


def test_the_formula_breaks_far_away_and_near_a_pole() -> None:
    assert off_share(50.0, 1_000_000.0) > 0.05
    assert off_share(89.0, 50_000.0) > 0.1
    assert off_share(89.99, 2_000.0) == math.inf, "it goes over the pole"


def test_the_table_of_the_docs_is_what_is_measured() -> None:
    text = DOCS.read_text(encoding="utf-8")
    head = re.search(r"\| start at \|(.+)\|\n", text)
    assert head is not None
    ways = [float(w.split()[0]) * (1000.0 if "km" in w else 1.0) for w in head[1].split("|") if w.strip()]
    rows = re.findall(r"\| ([0-9.]+)° north \|(.+)\|\n", text)
    assert len(rows) >= 4
    for lat, cells in rows:
        for metres, cell in zip(ways, cells.split("|"), strict=True):
            share = off_share(float(lat), metres)
            result = math.inf if "beyond" in cell else float(cell.strip().rstrip("%")) / 100.0
            assert share == result or share == pytest.approx(result, rel=0.06), (lat, metres, share)


@pytest.mark.parametrize(
    ("heading", "forward", "left"),
    [(90.0, "east", "north"), (0.0, "north", "west"), (180.0, "south", "east"), (270.0, "west", "south")],
)
def test_forward_and_left_follow_the_heading(heading: float, forward: str, left: str) -> None:
    azimuths = {"north": 0.0, "east": 90.0, "south": 180.0, "west": -90.0}
    frame = RobotFrame(Start(LatLon(50.0, 14.0), heading))
    there = frame.latlon_from_xy(np.array([[500.0, 0.0], [0.0, 500.0]]))
    for (lat, lon), direction in zip(there.tolist(), (forward, left), strict=True):
        azimuth, _, metres = GEOD.inv(14.0, 50.0, lon, lat)
        assert metres == pytest.approx(500.0, abs=1e-6)
        assert math.remainder(azimuth - azimuths[direction], 360.0) == pytest.approx(0.0, abs=1e-6)


@given(
    lat=st.floats(-89.9, 89.9),
    lon=st.floats(-180.0, 180.0),
    heading=st.floats(0.0, 360.0),
    metres=st.floats(0.01, 1e6),
    bearing=st.floats(0.0, 2 * math.pi),
)
def test_distance_and_direction_from_the_start_are_the_geodesics(
    lat: float, lon: float, heading: float, metres: float, bearing: float
) -> None:
    frame = RobotFrame(Start(LatLon(lat, lon), heading))
    xy = metres * np.array([[math.cos(bearing), math.sin(bearing)]])
    there = frame.latlon_from_xy(xy)
    want_lon, want_lat, _ = GEOD.fwd(lon, lat, heading - math.degrees(bearing), metres)
    _, _, off = GEOD.inv(there[0, 1], there[0, 0], want_lon, want_lat)
    # PROJ treats a start within 1e-10 rad of the equator or of 180° as exactly there: 0.6 mm.
    assert off < 1e-3 + 1e-9 * metres


def test_a_log_begun_on_the_way_starts_at_the_start() -> None:
    yaw = math.radians(30.0)
    local = LocalPoses(
        np.array([10.0, 11.0]),
        np.array([[8.0, -3.0, 1.0], [8.0 + math.cos(yaw), -3.0 + math.sin(yaw), 1.5]]),
        np.array([yaw, yaw + math.radians(90.0)]),
        np.array([[4.0, 1.0, 0.0], [np.nan, np.nan, np.nan]]),
    )
    start = Start(LatLon(50.0, 14.0), 0.0)
    poses = RobotFrame(start, anchor_of(local)).poses(local)
    assert poses.latlon[0] == pytest.approx([50.0, 14.0], abs=1e-12)
    azimuth, _, metres = GEOD.inv(14.0, 50.0, poses.latlon[1, 1], poses.latlon[1, 0])
    assert metres == pytest.approx(1.0, abs=1e-9), "it went 1 m forward"
    assert azimuth == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(poses.heading_deg, [0.0, 270.0]), "a left turn of a quarter"
    assert np.allclose(poses.height_m, [0.0, 0.5])


def test_covariances_turn_with_the_frame() -> None:
    local = LocalPoses(np.array([0.0]), np.zeros((1, 3)), np.array([np.nan]), np.array([[4.0, 1.0, 0.5]]))
    east = RobotFrame(Start(LatLon(50.0, 14.0), 90.0)).poses(local)
    assert np.allclose(east.covariance_m2, [[4.0, 1.0, 0.5]]), "forward is east"
    north = RobotFrame(Start(LatLon(50.0, 14.0), 0.0)).poses(local)
    assert np.allclose(north.covariance_m2, [[1.0, 4.0, -0.5]]), "forward is north, left is west"
    assert math.isnan(north.heading_deg[0])


def test_an_unknown_yaw_at_the_start_counts_as_none() -> None:
    local = LocalPoses(np.array([0.0]), np.ones((1, 3)), np.array([np.nan]), np.full((1, 3), np.nan))
    assert anchor_of(local) == Anchor(1.0, 1.0, 1.0, 0.0)


def test_headings_are_brought_into_one_turn() -> None:
    poses = make_poses([0.0] * 4, np.zeros((4, 2)), heading_deg=[-90.0, 360.0, 720.5, -1e-20])
    assert poses.heading_deg.tolist() == [270.0, 0.0, 0.5, 0.0]
