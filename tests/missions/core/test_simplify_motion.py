"""A thinned motion is within the tolerance of the whole one at all times."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import Geod

from webapp.missions.core.trajectory.thinning import GAP_S, simplify_motion

WGS84 = Geod(ellps="WGS84")
STEPS = arrays(np.float64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-5, 5))


def latlon_of(east_m, north_m, *, lat=50.0, lon=14.0):
    metres_east = WGS84.inv(lon, lat, lon + 1e-3, lat)[2] / 1e-3
    metres_north = WGS84.inv(lon, lat, lon, lat + 1e-3)[2] / 1e-3
    return np.column_stack([lat + north_m / metres_north, lon + east_m / metres_east])


def errors_m(times_s, latlon, height_m, keep):
    """Return the geodesic distance of each pose from the thinned motion at its time."""
    kept = times_s[keep]
    lat, lon = (np.interp(times_s, kept, np.unwrap(column[keep], period=360)) for column in latlon.T)
    flat = WGS84.inv(lon, lat, latlon[:, 1], latlon[:, 0])[2]
    return np.hypot(flat, height_m - np.interp(times_s, kept, height_m[keep]))


@given(steps=STEPS, tolerance_m=st.floats(0.01, 20.0), lat=st.sampled_from([0.0, 50.0, -84.0]))
def test_at_no_time_it_is_farther_off_than_the_tolerance(steps, tolerance_m, lat):
    way = np.cumsum(steps, axis=0)
    times_s = 1.7e9 + np.arange(len(way)) / 10
    latlon = latlon_of(way[:, 0], way[:, 1], lat=lat)
    keep = simplify_motion(times_s, latlon, height_m=way[:, 2], tolerance_m=tolerance_m)
    assert keep[0] and keep[-1]
    assert errors_m(times_s, latlon, way[:, 2], keep).max() <= tolerance_m * 1.001


def test_a_stop_stays_a_stop():
    """Five seconds ahead at 1 m/s, ten at rest, five ahead: a single line would mean uniform motion."""
    times_s = np.arange(0.0, 20.1, 0.1)
    north = np.clip(times_s, 0, 5) + np.clip(times_s - 15, 0, None)
    keep = simplify_motion(times_s, latlon_of(0 * north, north), height_m=0 * north, tolerance_m=0.1)
    assert np.flatnonzero(keep).tolist() == pytest.approx([0, 50, 150, 200], abs=1)


def test_both_ends_of_a_gap_stay_and_of_what_has_no_height_and_where_time_goes_back():
    times_s = np.concatenate([np.arange(20.0), 100 + np.arange(20.0), 50 + np.arange(20.0)])
    height_m = np.zeros(60)
    height_m[5:10] = np.nan
    north = times_s * 1.0
    keep = simplify_motion(times_s, latlon_of(0 * north, north), height_m=height_m, tolerance_m=5.0)
    assert np.flatnonzero(keep).tolist() == [0, 4, 5, 9, 10, 19, 20, 39, 40, 59]


def test_gaps_stay_in_a_motion_that_was_thinned_before():
    """A gap of a minute is kept between poses thinned to one in twenty seconds."""
    times_s = np.concatenate([np.arange(0.0, 101, 20), np.arange(160.0, 261, 20)])
    latlon, height_m = latlon_of(0 * times_s, times_s), 0 * times_s
    for gap_s, gap_stays in ((None, False), (GAP_S, True)):
        keep = simplify_motion(times_s, latlon, height_m=height_m, tolerance_m=5.0, gap_s=gap_s)
        assert keep[[5, 6]].all() == gap_stays


def test_a_way_over_the_180th_meridian_is_no_way_around_the_earth():
    times_s = np.arange(100.0)
    latlon = np.column_stack([np.zeros(100), (179.9999 + times_s * 1e-5 + 180) % 360 - 180])
    keep = simplify_motion(times_s, latlon, height_m=np.full(100, np.nan), tolerance_m=0.5)
    assert keep.sum() == 2


@pytest.mark.parametrize("count", [0, 1, 2])
def test_of_few_poses_all_stay(count):
    times_s = np.arange(float(count))
    keep = simplify_motion(times_s, np.zeros((count, 2)), height_m=times_s, tolerance_m=1.0)
    assert keep.tolist() == [True] * count
