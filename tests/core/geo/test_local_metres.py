"""Local metres agree with the geodesic."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyproj import Geod

from webapp.core.geo.crs import crs_name, latlon_from_plane, parse_crs, plane_from_latlon
from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.types import EnuMetres, LatLon
from webapp.errors import GeoreferenceError

GEOD = Geod(ellps="WGS84")
lats, lons = st.floats(-89.0, 89.0), st.floats(-180.0, 180.0)


@example(lat=0.0, lon=6.19831971103029e-09, azimuth=0.0, distance=1.0)
@given(lat=lats, lon=lons, azimuth=st.floats(-180, 180), distance=st.floats(0.01, 20_000))
def test_distance_and_azimuth_are_the_geodesics(lat, lon, azimuth, distance):
    lon2, lat2, _ = GEOD.fwd(lon, lat, azimuth, distance)
    east, north, up = LocalFrame(LatLon(lat, lon)).enu_of(LatLon(lat2, lon2))
    wanted = (distance * math.sin(math.radians(azimuth)), distance * math.cos(math.radians(azimuth)))
    # PROJ takes an origin within about 1e-10 rad of the equator or of 0° to be there: 0.7 mm.
    assert math.dist((east, north), wanted) < 1e-3
    assert up == 0.0


@given(
    lat=lats,
    lon=lons,
    a=st.tuples(st.floats(-1000, 1000), st.floats(-1000, 1000)),
    b=st.tuples(st.floats(-1000, 1000), st.floats(-1000, 1000)),
)
def test_distances_away_from_the_origin_are_true_to_a_millimetre(lat, lon, a, b):
    (lat1, lon1), (lat2, lon2) = LocalFrame(LatLon(lat, lon)).latlon_from_enu([a, b])
    assert GEOD.inv(lon1, lat1, lon2, lat2)[2] == pytest.approx(math.dist(a, b), abs=1e-3)


@example(lat=50.0, lon=14.0, east=0.0, north=1e-05)
@example(lat=0.0, lon=-78.94, east=-0.000545, north=0.000618)
@given(lat=lats, lon=lons, east=st.floats(-1e5, 1e5), north=st.floats(-1e5, 1e5))
def test_there_and_back(lat, lon, east, north):
    frame = LocalFrame(LatLon(lat, lon))
    back = frame.enu_of(frame.latlon_of(EnuMetres(east, north)))
    # PROJ takes a point within 1e-10 rad of the origin in latitude and longitude to be the origin.
    at_the_origin = math.hypot(east, north) < 1e-3
    assert math.dist(back[:2], (east, north)) < (1e-3 if at_the_origin else 1e-5)


def test_what_is_no_position_is_nan():
    frame = LocalFrame(LatLon(50, 14))
    assert np.isnan(frame.enu_from_latlon([(95, 14), (np.nan, 14), (50, np.inf)])).all()
    assert np.isnan(frame.latlon_from_enu([(np.nan, 0), (0, np.inf)])).all()
    assert np.isfinite(frame.enu_from_latlon([(51, 14)])).all()


@pytest.mark.parametrize("epsg", ["EPSG:4326", "EPSG:32633", "EPSG:3857", "EPSG:5514", "EPSG:4258"])
def test_planes_are_east_first_whatever_their_authority_says(epsg):
    (x, y), (x2, y2), (x3, y3) = plane_from_latlon(epsg, [(50.0, 14.0), (50.0, 14.01), (50.01, 14.0)])
    assert x2 - x > abs(y2 - y)
    assert y3 - y > abs(x3 - x)
    assert latlon_from_plane(epsg, [(x, y)])[0] == pytest.approx((50.0, 14.0), abs=2e-8)


def test_longitude_is_wrapped():
    assert latlon_from_plane("EPSG:4326", [(190.0, 1.0), (180.0, 1.0), (-200.0, 1.0)])[:, 1].tolist() == [
        -170.0,
        180.0,
        160.0,
    ]


@pytest.mark.parametrize("name", ["", "EPSG:1", "no such thing", "EPSG:5773", "EPSG:4978"])
def test_what_is_no_plane_is_refused(name):
    with pytest.raises(GeoreferenceError) as caught:
        parse_crs(name)
    assert caught.value.hint


def test_a_name_is_short_where_that_is_exact():
    assert crs_name(parse_crs("EPSG:32633").to_wkt()) == "EPSG:32633"
    local = LocalFrame(LatLon(1, 2)).plane
    assert crs_name(local) == local


def test_centre():
    assert centre_of([(10, 179), (10, -179)]).lon == pytest.approx(180)
    assert centre_of([(10, 20)]) == pytest.approx((10, 20))
    assert centre_of([(0, 0), (0, 180)]) == (0, 0)
