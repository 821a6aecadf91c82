"""The prior pulls cameras across a path, never along it, and hardly among photos on all sides."""

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.priors import apply_path_prior, fit_path_prior

ALONG = np.arange(0.0, 2000.0, 10.0)
ROW = fit_path_prior(np.column_stack([ALONG, ALONG]), place_radius_px=28.0)
FIELD = fit_path_prior(
    np.array([(x, y) for x in range(0, 1000, 10) for y in range(0, 1000, 10)], float), place_radius_px=20.0
)


def moved(position, variance, paths):
    at, left = apply_path_prior(MapPixel(*position), variance, paths=paths)
    return np.array(at) - position, left


def test_positions_next_to_a_row_are_moved_towards_it():
    step, left = moved((1010.0, 990.0), 100.0, ROW)
    assert step[0] == pytest.approx(-step[1], abs=0.1)
    assert -10.0 < step[0] < -7.0
    assert left[0] < 10.0  # across the row
    assert left[1] == pytest.approx(100.0)


def test_a_circle_also_constrains_the_position_along_a_row():
    near = np.exp(-0.5 * ((ROW.photos - 1010.0) ** 2).sum(1) / 10.0**2)
    at, left = apply_path_prior(MapPixel(1000.0, 1000.0), 100.0, paths=ROW, weight=near)
    assert at.x == pytest.approx(at.y) and 1002.0 < at.x < 1009.0
    assert left[1] < 80.0


def test_nothing_is_moved_along_a_row():
    step, _ = moved((1003.0, 1003.0), 100.0, ROW)
    assert np.abs(step).max() < 0.2


def test_what_is_exact_stays():
    step, _ = moved((1010.0, 990.0), 1.0, ROW)
    assert np.abs(step).max() < 0.3


@pytest.mark.parametrize("off", [80.0, 3000.0])
def test_what_is_far_from_all_paths_stays(off):
    step, left = moved((1000.0 + off, 1000.0 - off), 100.0, ROW)
    assert np.abs(step).max() < 0.1
    assert left == pytest.approx(100.0, rel=0.01)


def test_photos_on_all_sides_move_little():
    step, _ = moved((503.0, 497.0), 100.0, FIELD)
    assert np.abs(step).max() < 0.3


@pytest.mark.parametrize("alone", [[[500.0, 500.0]], [[500.0, 500.0], [501.0, 500.0]]])
def test_a_spot_is_no_path(alone):
    step, left = moved((510.0, 505.0), 100.0, fit_path_prior(np.array(alone), place_radius_px=20.0))
    assert np.abs(step).max() == 0.0
    assert left == pytest.approx(100.0)


def test_nothing_is_moved_along_a_row_at_its_end_either():
    step, _ = moved((-8.0, 8.0), 100.0, ROW)
    assert step[0] == pytest.approx(-step[1], abs=0.2) and step[0] > 4.0
