"""Omitted points are within the tolerance of the line; profiles keep extremes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from webapp.missions.core.trajectory.distance import profile
from webapp.missions.core.trajectory.thinning import simplify

DEGREE_M = 111_195.0


def distance_m(point, a, b):
    """Return the distance from a point to the segment from a to b, at the equator."""
    point, a, b = (np.asarray(p) * DEGREE_M for p in (point, a, b))
    way = b - a
    along = np.clip(np.dot(point - a, way) / max(np.dot(way, way), 1e-300), 0, 1)
    return np.hypot(*(point - a - along * way))


@given(
    metres=arrays(np.float64, st.tuples(st.integers(1, 60), st.just(2)), elements=st.floats(-50, 50)),
    tolerance=st.floats(0.0, 30.0),
)
def test_what_is_left_out_is_near(metres, tolerance):
    latlon = metres / DEGREE_M
    keep = simplify(latlon, tolerance)
    assert keep[0]
    assert keep[-1]
    kept = np.flatnonzero(keep)
    for place in np.flatnonzero(~keep):
        after = np.searchsorted(kept, place)
        far = distance_m(latlon[place], latlon[kept[after - 1]], latlon[kept[after]])
        assert far <= tolerance + 1e-3


def test_a_straight_way_is_two_points():
    latlon = np.column_stack([np.full(5000, 50.0), np.linspace(14, 14.01, 5000)])
    assert simplify(latlon, 0.5).sum() == 2


def test_a_corner_stays():
    latlon = np.array([[0, 0], [0, 1], [0, 2], [1, 2], [2, 2]]) * 1e-4
    assert simplify(latlon, 1.0).tolist() == [True, False, True, False, True]


def test_a_round_comes_back_to_its_start():
    angle = np.linspace(0, 2 * np.pi, 400)
    latlon = np.column_stack([np.sin(angle), np.cos(angle)]) * 1e-3
    assert 8 < simplify(latlon, 1.0).sum() < 100


def test_across_the_180th_meridian():
    latlon = np.array([[0.0, 179.9999], [0.0, 180.0], [0.0, -179.9999]])
    assert simplify(latlon, 0.5).tolist() == [True, False, True]


def test_none():
    assert simplify(np.empty((0, 2)), 1.0).shape == (0,)


def test_profile_of_few_poses_is_all_of_them():
    result = profile(
        np.arange(4.0), np.array([0, 2, 4, 4.0]), height_m=np.array([1, 2, np.nan, 3]), points=10
    )
    assert result[:, 0].tolist() == [0, 1, 2, 3]
    assert result[:, 2] == pytest.approx([np.nan, 2, 2, 0], nan_ok=True)
    assert result[:, 3] == pytest.approx([1, 2, np.nan, 3], nan_ok=True)


def test_profile_keeps_peaks():
    height = np.zeros(10_000)
    height[1234], height[7777] = 50.0, -20.0
    result = profile(np.arange(10_000) * 0.1, np.arange(10_000) * 0.2, height_m=height, points=100)
    assert len(result) <= 100
    assert (result[:, 3].max(), result[:, 3].min()) == (50.0, -20.0)
    assert np.all(np.diff(result[:, 0]) > 0)
    assert result[1:, 2] == pytest.approx(2.0)


def test_profile_without_heights():
    result = profile(np.arange(1000.0), np.arange(1000.0), height_m=np.full(1000, np.nan), points=10)
    assert result[0, 0] == 0
    assert result[-1, 0] == 999


def test_times_that_stand_still_have_no_speed():
    result = profile(np.zeros(3), np.arange(3.0), height_m=np.zeros(3), points=5)
    assert np.isnan(result[:, 2]).all()
