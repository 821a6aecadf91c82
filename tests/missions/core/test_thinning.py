"""Thinning by degrees and by metres; distances are measured before it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from webapp.errors import UsageError
from webapp.missions.core.trajectory.distance import Odometer, steps_m
from webapp.missions.core.trajectory.records import join, make_poses
from webapp.missions.core.trajectory.thinning import MinMove, Thinner, parse_min_move

WAY = st.lists(st.tuples(st.integers(-30, 30), st.integers(-30, 30)), min_size=1, max_size=60)


def as_latlon(way: list[tuple[int, int]]) -> np.ndarray:
    """Return positions on a grid with a spacing of a third of the default threshold."""
    return np.array([50.0, 14.0]) + np.array(way, dtype=np.float64) * 3.3e-6


@given(way=WAY, cut=st.integers(0, 60))
def test_pieces_are_thinned_and_measured_as_one(way: list[tuple[int, int]], cut: int) -> None:
    latlon = as_latlon(way)
    whole, parts = Thinner(MinMove()), Thinner(MinMove())
    expected = whole.keep(latlon)
    assert np.array_equal(np.concatenate([parts.keep(latlon[:cut]), parts.keep(latlon[cut:])]), expected)
    assert parts.skipped == whole.skipped == len(way) - expected.sum()
    meter, again = Odometer(), Odometer()
    assert np.allclose(np.concatenate([meter.add(latlon[:cut]), meter.add(latlon[cut:])]), again.add(latlon))
    assert meter.metres == pytest.approx(float(steps_m(latlon).sum()))


@given(way=WAY)
def test_every_kept_pose_moved_and_no_skipped_one_did(way: list[tuple[int, int]]) -> None:
    latlon = as_latlon(way)
    last = None
    for kept, position in zip(Thinner(MinMove()).keep(latlon), latlon, strict=True):
        moved = last is None or np.abs(position - last).max() > 0.00001
        assert kept == moved
        last = position if kept else last


def test_zero_keeps_what_stands_still() -> None:
    thinner = Thinner(parse_min_move("0"))
    assert thinner.keep(np.full((5, 2), 14.0)).all()
    assert thinner.skipped == 0


def test_metres_are_metres_in_every_direction() -> None:
    lon, lat, _ = Geod(ellps="WGS84").fwd([14.0] * 2, [60.0] * 2, [0.0, 90.0], [0.6, 0.6])
    for position in zip(lat, lon, strict=True):
        track = np.array([[60.0, 14.0], position])
        assert Thinner(MinMove(0.5, "m")).keep(track).tolist() == [True, True]
        assert Thinner(MinMove(0.7, "m")).keep(track).tolist() == [True, False]


def test_a_step_over_the_180th_meridian_is_a_small_one() -> None:
    track = np.array([[10.0, 179.999999], [10.0, -179.999999]])
    assert Thinner(MinMove()).keep(track).tolist() == [True, False]
    assert steps_m(track)[0] == pytest.approx(0.22, abs=0.01)


@pytest.mark.parametrize(
    ("text", "value", "unit"), [("0.5m", 0.5, "m"), ("0.00001deg", 1e-5, "deg"), ("1e-5 deg", 1e-5, "deg")]
)
def test_a_threshold_is_read_and_written(text: str, value: float, unit: str) -> None:
    assert parse_min_move(text) == MinMove(value, unit)
    assert parse_min_move(str(parse_min_move(text))) == parse_min_move(text)


@pytest.mark.parametrize("text", ["", "1", "-1m", "nan", "1 km", "1e999m"])
def test_what_is_no_threshold_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="not a distance with a unit"):
        parse_min_move(text)


def test_parts_are_joined() -> None:
    one = make_poses([1.0, 2.0], [(50.0, 14.0)] * 2, travelled_m=[0.0, 3.0])
    assert join([one.take(slice(0, 1)), one.take(np.array([False, True]))]).travelled_m.tolist() == [0.0, 3.0]
    assert len(join([])) == 0
