"""The grid of web map tiles."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.tilegrid import MAX_LATITUDE, GeoBox, Tile, TileCut, cut_of
from webapp.errors import GeoreferenceError


def mercator_pixels(lat, lon, zoom):
    """Compute pixels by the formula of slippy maps, independently of the program."""
    size = 256 * 2**zoom
    x = (lon + 180) / 360 * size
    y = (1 - math.asinh(math.tan(math.radians(lat))) / math.pi) / 2 * size
    return x, y


def test_the_earth_is_one_tile_at_zoom_0():
    cut = cut_of(GeoBox(north=MAX_LATITUDE, south=-MAX_LATITUDE, west=-180, east=180), 0)
    assert cut == TileCut(0, 0, 0, width=256, height=256)
    assert list(cut.tiles()) == [(Tile(0, 0), 0, 0)]


@given(
    lat=st.floats(-80, 80),
    lon=st.floats(-179, 178),
    zoom=st.integers(10, 20),
    high=st.floats(0.0005, 0.01),
    wide=st.floats(0.0005, 0.01),
)
def test_edges_are_the_nearest_pixels_and_the_georeference_is_exact(lat, lon, zoom, high, wide):
    cut = cut_of(GeoBox(north=lat + high, south=lat, west=lon, east=lon + wide), zoom)
    left, top = mercator_pixels(lat + high, lon, zoom)
    right, bottom = mercator_pixels(lat, lon + wide, zoom)
    assert abs(cut.left - left) <= 0.501
    assert abs(cut.top - top) <= 0.501
    assert abs(cut.left + cut.width - right) <= 1.501  # half a pixel each, or a narrow area widened to one
    assert abs(cut.top + cut.height - bottom) <= 1.501
    at = cut.georeference.pixel_from_latlon([(lat + high / 2, lon + wide / 2)])[0]
    expected = np.subtract(mercator_pixels(lat + high / 2, lon + wide / 2, zoom), (cut.left, cut.top))
    assert at == pytest.approx(expected, abs=1e-3)


def test_tiles_cover_the_rectangle_once():
    cut = TileCut(4, 300, 250, width=600, height=530)
    covered = np.zeros((cut.height, cut.width), int)
    for _, left, top in cut.tiles():
        covered[max(top, 0) : top + 256, max(left, 0) : left + 256] += 1
    assert (covered == 1).all()
    assert cut.tile_count == len(list(cut.tiles())) == 3 * 4


def test_an_area_across_the_180th_meridian():
    cut = cut_of(GeoBox(north=-16.5, south=-17, west=179.8, east=-179.7), 12)
    assert cut.width == pytest.approx(0.5 / 360 * 256 * 2**12, abs=1)
    assert {tile.x for tile, _, _ in cut.tiles()} == {4093, 4094, 4095, 0, 1, 2, 3}
    west, east = cut.georeference.latlon_from_pixel([(0, 0), (cut.width, 0)])[:, 1]
    assert west == pytest.approx(179.8, abs=1e-3)
    assert east == pytest.approx(-179.7, abs=1e-3)
    x, _ = cut.georeference.pixel_from_latlon([(-16.7, -179.9)])[0]
    assert x == pytest.approx(0.3 / 360 * 256 * 2**12, abs=1)


def test_a_pixel_has_the_size_that_is_known_for_the_equator():
    cut = cut_of(GeoBox(north=0.001, south=-0.001, west=10, east=10.002), 18)
    assert cut.metres_per_pixel == pytest.approx(0.597, rel=0.01)


@pytest.mark.parametrize(
    ("box", "zoom", "why"),
    [
        (GeoBox(north=50, south=50, west=14, east=15), 10, "empty"),
        (GeoBox(north=49, south=50, west=14, east=15), 10, "empty"),
        (GeoBox(north=50, south=49, west=14, east=14), 10, "empty"),
        (GeoBox(north=86, south=49, west=14, east=15), 10, "85 degrees"),
        (GeoBox(north=50, south=49, west=14, east=195), 10, "not on the Earth"),
        (GeoBox(north=math.nan, south=49, west=14, east=15), 10, "not on the Earth"),
        (GeoBox(north=50, south=49, west=14, east=15), 25, "zoom 25 does not exist"),
    ],
)
def test_what_is_no_area_is_refused(box, zoom, why):
    with pytest.raises(GeoreferenceError, match=why):
        cut_of(box, zoom)
