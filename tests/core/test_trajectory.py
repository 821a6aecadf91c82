"""Positions on a track by time, and clock offsets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.core.trajectory import ClockOffset, estimate_offset, make_track, match

HERE = LatLon(50.0, 14.0)


def track_of(*fixes):
    """A track of (time, lat, lon)."""
    return make_track([t for t, _, _ in fixes], [LatLon(lat, lon) for _, lat, lon in fixes])


LINE = track_of((0, 50.0, 14.0), (10, 50.001, 14.002), (100, 50.002, 14.004), (110, 50.003, 14.006))


def test_between_two_fixes_it_is_on_the_line():
    (found,) = match(LINE, [2.5], max_gap_s=60)
    assert found.position == pytest.approx((50.00025, 14.0005))
    assert found.gap_s == 10


@pytest.mark.parametrize("t", [0.0, 10.0, 100.0, 110.0])
def test_at_a_fix_it_is_the_fix(t):
    (found,) = match(LINE, [t], max_gap_s=60)
    row = LINE.latlon[list(LINE.times_s).index(t)]
    assert found.position == pytest.approx(tuple(row))


def test_a_gap_is_not_bridged_but_its_ends_reach_into_it():
    near, middle, late = match(LINE, [35.0, 55.0, 75.0], max_gap_s=60)
    assert near.position == pytest.approx((50.001, 14.002))
    assert not middle and middle.reason == "the track has a gap of 90 s there"
    assert late.position == pytest.approx((50.002, 14.004))
    (bridged,) = match(LINE, [55.0], max_gap_s=90)
    assert bridged.position == pytest.approx((50.0015, 14.003))


def test_before_and_after_the_track():
    reasons = [m.reason for m in match(LINE, [-31.0, 141.0, 110 + 10_000.0], max_gap_s=60)]
    assert reasons == [
        "it was taken 31 s before the track begins",
        "it was taken 31 s after the track ends",
        "it was taken 2.8 h after the track ends",
    ]
    before, after = match(LINE, [-30.0, 140.0], max_gap_s=60)
    assert (before.position.lat, after.position.lat) == (50.0, 50.003)


def test_across_the_date_line_it_goes_the_short_way():
    track = track_of((0, 0.0, 179.999), (10, 0.0, -179.999))
    (found,) = match(track, [7.5], max_gap_s=60)
    assert found.position.lon == pytest.approx(-179.9995)


def test_fixes_are_sorted_and_the_first_of_a_time_counts():
    track = track_of((10, 2, 2), (0, 1, 1), (10, 9, 9))
    assert track.times_s.tolist() == [0, 10]
    assert track.latlon.tolist() == [[1, 1], [2, 2]]


@settings(deadline=None)
@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=30), st.floats(-1e5, 1.1e6), st.floats(0.1, 1e5))
def test_what_is_found_is_between_fixes(times, t, gap):
    track = make_track(times, [LatLon(50 + n * 1e-4, 14) for n in range(len(times))])
    (found,) = match(track, [t], max_gap_s=gap)
    if found:
        assert track.latlon[:, 0].min() - 1e-9 <= found.position.lat <= track.latlon[:, 0].max() + 1e-9
        assert np.abs(track.times_s - t).min() <= gap
        assert found.gap_s <= gap


def walk(seconds):
    """Return a loop with a corner; metres, (n, 2)."""
    s = np.asarray(seconds, dtype=float)
    return np.column_stack([60 * np.sin(s / 90), 40 * np.sin(s / 37 + 1)])


@pytest.mark.parametrize("offset", [0.0, 37.0, -3600.0, 7200.0 + 13])
def test_the_offset_of_a_clock_is_found(offset):
    frame, rng = LocalFrame(HERE), np.random.default_rng(0)
    at = np.arange(0, 900, 5)
    track = make_track(at + 1e9, [LatLon(*row) for row in frame.latlon_from_enu(walk(at))])
    taken = np.sort(rng.uniform(20, 880, 12))
    seen = frame.latlon_from_enu(walk(taken) + rng.normal(0, 1.0, (12, 2)))
    found = estimate_offset(track, taken + 1e9 - offset, latlon=seen)
    assert isinstance(found, ClockOffset)
    assert found.offset_s == pytest.approx(offset, abs=6)
    assert found.median_m < 6


def test_photos_elsewhere_or_too_few_give_no_offset():
    far = estimate_offset(LINE, [1, 2, 3], latlon=[(40, 14), (40.1, 14), (40.2, 14)])
    assert not far and "not near this track" in far.reason
    few = estimate_offset(LINE, [1, 2], latlon=[(50, 14), (50, 14)])
    assert not few and "only 2" in few.reason
    assert not estimate_offset(LINE, [], latlon=[])
