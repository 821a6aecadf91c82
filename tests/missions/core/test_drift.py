"""Detection of closed tracks, and their gaps."""

import numpy as np
import pytest

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.drift import measure_closure

FRAME = LocalFrame(LatLon(50.1, 14.4))


def drift_of(corners):
    """Return `measure_closure` of the track through offsets in metres east and north."""
    enu = np.array(corners, dtype=float)
    latlon = FRAME.latlon_from_enu(enu)
    (south, west), (north, east) = latlon.min(axis=0), latlon.max(axis=0)
    way = float(np.hypot(*np.diff(enu, axis=0).T).sum())
    ends = LatLon(*latlon[0].tolist()), LatLon(*latlon[-1].tolist())
    return measure_closure(*ends, distance_m=way, bounds=(south, west, north, east))


def test_a_square_that_misses_its_start_by_three_metres():
    found = drift_of([(0, 0), (100, 0), (100, 100), (0, 100), (0, 3)])
    assert found.gap_m == pytest.approx(3, abs=0.001)
    assert found.share == pytest.approx(3 / 397, rel=1e-4)


def test_there_and_back_on_the_same_way_closes():
    assert drift_of([(0, 0), (0, 80), (1, 0)]).gap_m == pytest.approx(1, abs=0.001)


def test_a_perfect_round_has_no_gap():
    assert drift_of([(0, 0), (50, 0), (50, 50), (0, 0)]).gap_m == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("corners", "why"),
    [
        ([(0, 0), (200, 0)], "never farther"),
        ([(0, 0), (100, 0), (60, 0)], "never farther"),
        ([(0, 0), (2, 0), (0, 2), (0, 0)], "stays within"),
        ([(0, 0), (60, 0), (16, 0)], "a tenth"),
    ],
)
def test_what_does_not_close_says_why(corners, why):
    found = drift_of(corners)
    assert not found
    assert why in found.reason


def test_across_the_date_line():
    frame = LocalFrame(LatLon(10.0, 179.9999))
    away = frame.latlon_of(frame.enu_of(LatLon(10.0, -179.999)))
    found = measure_closure(
        LatLon(10.0, 179.9999),
        LatLon(10.0, 179.99995),
        distance_m=300,
        bounds=(10.0, 179.9999, 10.0, away.lon),
    )
    assert found.gap_m == pytest.approx(5.5, abs=0.1)
