"""The blank plan around positions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.blank import draw, plan_around, round_up
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel

offsets = st.lists(st.tuples(st.floats(-3000, 3000), st.floats(-3000, 3000)), min_size=1, max_size=10)


@given(offsets=offsets, lat=st.floats(-80, 80), lon=st.floats(-180, 180))
def test_positions_have_their_margin(offsets, lat, lon):
    latlon = LocalFrame(LatLon(lat, lon)).latlon_from_enu(offsets)
    plan = plan_around(latlon)
    pixels = plan.georeference.pixel_from_latlon(latlon)
    extent = pixels.max(axis=0) - pixels.min(axis=0)
    low, high = 0.05 * extent - 1e-3, (plan.width, plan.height) - 0.05 * extent + 1e-3
    assert (pixels >= low).all()
    assert (pixels <= high).all()
    assert 990 <= max(plan.width, plan.height) <= 2001
    assert min(plan.width, plan.height) >= 490


def test_north_is_up_and_pixels_are_as_large_as_said():
    plan = plan_around([(55.70, 13.19), (55.71, 13.20)])
    middle = MapPixel(plan.width / 2, plan.height / 2)
    assert plan.georeference.north_deg(middle) == pytest.approx(0, abs=0.02)
    assert plan.georeference.metres_per_pixel(middle) == pytest.approx(plan.metres_per_pixel, rel=1e-6)


@pytest.mark.parametrize("count", [1, 5])
def test_one_place_gets_fifty_metres(count):
    plan = plan_around([(55.70, 13.19)] * count)
    assert plan.width * plan.metres_per_pixel == pytest.approx(50)
    assert plan.georeference.pixel_of(LatLon(55.70, 13.19)) == pytest.approx((1000, 1000), abs=1e-3)


def test_photos_on_three_continents():
    latlon = [(43.4, 11.8), (41.2, -96.0), (-33.0, 151.0)]
    plan = plan_around(latlon)
    pixels = plan.georeference.pixel_from_latlon(latlon)
    assert ((pixels > 0) & (pixels < (plan.width, plan.height))).all()


@pytest.mark.parametrize(
    ("value", "wanted"), [(0.9, 1), (1, 1), (1.01, 2), (2.1, 2.5), (0.3, 0.5), (70, 100)]
)
def test_round_numbers(value, wanted):
    assert round_up(value) == pytest.approx(wanted)


def test_the_drawing_has_a_grid_on_light_paper():
    plan = plan_around([(55.70, 13.19), (55.701, 13.191)])
    image = draw(plan)
    assert image.shape == (plan.height, plan.width, 3)
    assert image.dtype == np.uint8
    assert image.mean() > 230
    paper = image[200:-200, 200:-200, 0]
    columns = np.flatnonzero((paper < 235).all(axis=0)) + 200
    east = (plan.east_m + columns * plan.metres_per_pixel) / plan.metres_per_pixel
    assert len(columns) >= 3
    steps = np.diff(east)
    assert np.abs(steps - steps[0]).max() <= 1.0
