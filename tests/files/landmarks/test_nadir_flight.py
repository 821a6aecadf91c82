"""Photos straight down over flat ground keep their focal length, and the heights of their cameras."""

import numpy as np
import pytest

from benchmarks import nadir_flights


def joined(folder, *, rows, heights_m, exif_off):
    rng = np.random.default_rng([52, 0])
    flight = nadir_flights.fly(rng, rows=rows, columns=5, heights_m=heights_m, exif_off=exif_off)
    return nadir_flights.Joined(flight, folder, clicks=5, rng=rng)


def test_at_one_height_the_focal_length_stays_near_that_of_exif(tmp_path):
    flight = joined(tmp_path, rows=3, heights_m=(40.0,), exif_off=0.02)
    assert abs(flight.focal_before - 1.0) > 0.1, "the photos alone hardly show it"
    found = flight.adjusted(altitudes=True, focal_prior=True)
    assert found.focal == pytest.approx(1.02, abs=0.03)
    assert found.height_m == pytest.approx(40.0, rel=0.05)
    assert np.median(found.error_m) < 2.0 * nadir_flights.CLICK_M


def test_at_two_heights_their_difference_measures_the_focal_length(tmp_path):
    flight = joined(tmp_path, rows=4, heights_m=(40.0, 60.0), exif_off=-0.09)
    found = flight.adjusted(altitudes=True, focal_prior=True)
    assert found.focal == pytest.approx(1.0, abs=0.05)
    assert np.median(found.error_m) < 2.0 * nadir_flights.CLICK_M
