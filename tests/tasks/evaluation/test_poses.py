import math

import pytest

from webapp.core.evaluation.metrics import QueryResult
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Map, SatelliteImage
from webapp.tasks.evaluation.evaluate import trajectories

RESULTS = [
    QueryResult("a.jpg", MapPixel(60, 40), None, "broken", truth_heading_deg=0.0),
    QueryResult("b.jpg", MapPixel(50, 50), None, "broken"),
]
PLAN = SatelliteImage("plan.png", 100, 100)


def test_without_a_georeference_it_is_map_pixels() -> None:
    poses = trajectories(RESULTS, Map(PLAN, ()))
    first, second = poses.truth
    assert (first.x, first.y) == (60, 40)
    # Heading up is from x (right) a quarter turn away from y (down).
    assert first.yaw_rad == pytest.approx(-math.pi / 2)
    assert second.yaw_rad is None
    assert "pixels" in poses.frame
    assert poses.estimate == []


def test_with_a_georeference_it_is_metres_from_the_first_true_position() -> None:
    # Near the central meridian of the zone, the grid differs from the ground only by the factor 0.9996.
    metric = Georeference("EPSG:32633", (0.5, 0, 500_000, 0, -0.5, 5_500_000, 0, 0, 1), "affine")
    poses = trajectories(RESULTS, Map(PLAN, (), metric))
    first, second = poses.truth
    assert (first.x, first.y) == (pytest.approx(0, abs=1e-6), pytest.approx(0, abs=1e-6))
    assert first.yaw_rad == pytest.approx(math.pi / 2)
    assert (second.x, second.y) == (pytest.approx(-5, rel=1e-3), pytest.approx(-5, rel=1e-3))
    assert "metres" in poses.frame


def tilted(slope: float) -> Georeference:
    """Return a view of the ground near (500000, 5500000), with a horizon at x = 1 / slope."""
    x, y = 500_000.0, 5_500_000.0
    rows = (0.5 - slope * x, 0, x, -slope * y, -0.5, y, -slope, 0, 1)
    return Georeference("EPSG:32633", rows, "projective")


def test_beyond_the_horizon_there_is_no_pose() -> None:
    half = trajectories(RESULTS, Map(PLAN, (), tilted(1 / 55)))
    assert [pose.timestamp for pose in half.truth] == [1.0]
    assert trajectories(RESULTS, Map(PLAN, (), tilted(1 / 10))).truth == []
