"""Heights of cameras from the altitudes of their photos."""

import numpy as np
import pytest

from webapp.core.landmarks.heights import Altitude, Altitudes

USUAL_PX = 40.0


def heights(*altitudes, px_per_m=10.0):
    return Altitudes(tuple(altitudes), px_per_m).heights(usual_px=USUAL_PX)


def flight(*above_start_m, start_m=100.0):
    return [Altitude(start_m + one, one) for one in above_start_m]


def test_differences_within_a_flight_count_and_its_level_does_not():
    low, high = heights(*flight(40, 60)), heights(*flight(140, 160, start_m=500.0))
    np.testing.assert_array_equal(low.height_px, high.height_px)
    assert low.height_px == pytest.approx([-100.0, 100.0], rel=0.03)
    assert low.sigma_px == pytest.approx([15.0, 15.0], rel=0.03)


def test_two_starts_are_two_flights():
    found = heights(*flight(40, 41), *flight(40, 42, start_m=112.0), *flight(40, start_m=130.0))
    assert found.flight.tolist() == [0, 0, 1, 1, -1], "one photo alone has no difference"
    assert np.isnan(found.height_px[4])


def test_a_start_that_drifts_slowly_is_one():
    found = heights(*(Altitude(150.0 + 0.5 * n, 50.0) for n in range(10)))
    assert found.flight.tolist() == [0] * 10


def test_altitudes_that_scatter_as_much_as_gps_does_say_little():
    """What is expected without them, about one height, then counts more."""
    rng = np.random.default_rng(4)
    found = heights(*(Altitude(200.0 + one) for one in rng.normal(0.0, 10.0, 60)))
    assert found.height_px.std() < USUAL_PX
    assert (found.sigma_px < 1.3 * USUAL_PX).all()
    hills = heights(*(Altitude(200.0 + 10.0 * n) for n in range(60)))
    assert hills.height_px == pytest.approx(100.0 * (np.arange(60) - 29.5), rel=0.01)


def test_a_gps_that_writes_0_is_left_out():
    found = heights(Altitude(501.0), Altitude(0.0), Altitude(499.0), Altitude(503.0), Altitude())
    assert found.flight.tolist() == [0, -1, 0, 0, -1]


def test_photos_without_altitudes_have_no_heights():
    assert (heights(Altitude(), Altitude()).flight == -1).all()
    assert len(heights().flight) == 0
