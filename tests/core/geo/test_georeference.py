"""Map pixels <-> latitude and longitude."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError

GEOD = Geod(ellps="WGS84")


def local(lat, lon, *, metres=0.25, turn_deg=0.0, tilt=0.0):
    """Make a georeference around a position; `turn_deg`: direction of north, clockwise from up."""
    t = math.radians(turn_deg)
    c, s = metres * math.cos(t), metres * math.sin(t)
    return Georeference(
        LocalFrame(LatLon(lat, lon)).plane, (c, s, -100.0, s, -c, 120.0, 0.0, tilt, 1.0), "affine"
    )


@given(
    lat=st.floats(-85, 85),
    lon=st.floats(-179, 179),
    turn=st.floats(-180, 180),
    tilt=st.floats(0, 1e-3),
    x=st.floats(-500, 5000),
    y=st.floats(0, 5000),
)
def test_there_and_back(lat, lon, turn, tilt, x, y):
    g = local(lat, lon, turn_deg=turn, tilt=tilt)
    assert math.dist(g.pixel_of(g.latlon_of(MapPixel(x, y))), (x, y)) < 1e-3 / 0.25


@given(turn=st.floats(-179, 179), metres=st.floats(0.01, 10))
def test_north_and_scale(turn, metres):
    g = local(50, 14, metres=metres, turn_deg=turn)
    # a pixel near the plane's origin, where grid north is true north
    pixel = g.pixel_of(LatLon(50, 14))
    assert g.north_deg(pixel) == pytest.approx(turn, abs=1e-4)
    assert g.metres_per_pixel(pixel) == pytest.approx(metres, rel=1e-6)


def test_utm_agrees_with_pyproj_to_a_millimetre():
    g = Georeference("EPSG:32633", (0.2, 0.0, 458_000.0, 0.0, -0.2, 5_548_000.0, 0.0, 0.0, 1.0), "geotiff")
    pixels = np.random.default_rng(1).uniform(0, 4000, (200, 2))
    east, north = 458_000 + 0.2 * pixels[:, 0], 5_548_000 - 0.2 * pixels[:, 1]
    lon, lat = Transformer.from_crs(32633, 4326, always_xy=True).transform(east, north)
    found = g.latlon_from_pixel(pixels)
    assert np.max(GEOD.inv(lon, lat, found[:, 1], found[:, 0])[2]) < 1e-3
    assert np.abs(g.pixel_from_latlon(found) - pixels).max() * 0.2 < 1e-3
    # grid convergence: west of the central meridian, true north is to the right of up
    middle = MapPixel(2000, 2000)
    ahead = LatLon(g.latlon_of(middle).lat + 1e-4, g.latlon_of(middle).lon)
    dx, dy = np.subtract(g.pixel_of(ahead), middle)
    assert g.north_deg(middle) == pytest.approx(math.degrees(math.atan2(dx, -dy)), abs=1e-3)
    assert abs(g.north_deg(middle)) > 0.1


def test_metres_of_pixels_are_geodesic():
    g = local(60.4, 22.5, turn_deg=30)
    frame = LocalFrame(g.latlon_of(MapPixel(100, 100)))
    enu = g.enu_from_pixel([(100, 100), (1300, 900)], frame)
    lat, lon = g.latlon_of(MapPixel(1300, 900))
    azimuth, _, distance = GEOD.inv(frame.origin.lon, frame.origin.lat, lon, lat)
    assert np.hypot(*enu[0]) < 1e-6
    assert np.hypot(*enu[1]) == pytest.approx(distance, abs=1e-3)
    assert math.degrees(math.atan2(*enu[1])) == pytest.approx(azimuth, abs=1e-6)
    assert g.pixel_from_latlon(frame.latlon_from_enu(enu)) == pytest.approx(
        np.array([(100, 100), (1300, 900)]), abs=1e-4
    )


def test_behind_the_horizon_is_nan():
    g = Georeference(LocalFrame(LatLon(50, 14)).plane, (1, 0, 0, 0, -1, 0, 0, -0.01, 1), "projective")
    assert np.isfinite(g.latlon_from_pixel([(10, 99)])).all()
    assert np.isnan(g.latlon_from_pixel([(10, 100), (10, 200), (np.nan, 0)])).all()
    assert math.isnan(g.metres_per_pixel(MapPixel(10, 200)))
    assert math.isnan(g.north_deg(MapPixel(10, 200)))


@pytest.mark.parametrize(
    "matrix", [(1.0,) * 9, (1.0, 0, 0, 0, 1, 0, 0, 0), (math.nan, 0, 0, 0, 1, 0, 0, 0, 1), (0.0,) * 9]
)
def test_a_matrix_without_an_inverse_is_refused(matrix):
    with pytest.raises(GeoreferenceError):
        Georeference("EPSG:4326", matrix, "affine")


@pytest.mark.parametrize(
    "matrix", [(0.5, -1e200, 300.0, 0.0, -1.0, -1.0), (-1e200, 300.0, 0.0, -1.0, 1e-300, 0.5)]
)
def test_no_north_where_the_image_is_a_line_or_beyond_all_numbers(matrix):
    georeference = Georeference("EPSG:4326", (*matrix, 0.0, 0.0, 1.0), "worldfile")
    found = [georeference.north_deg(MapPixel(x, y)) for x in (0.0, 0.5, 150.0) for y in (0.0, 0.5, 100.0)]
    assert any(map(math.isnan, found))


def test_a_matrix_beyond_all_numbers_has_no_inverse():
    with pytest.raises(GeoreferenceError, match="inverse"):
        Georeference("EPSG:4326", (1e200, 1e200, 1.0, -1e200, 1e200, 1.0, 0.0, 0.0, 1e10), "worldfile")
