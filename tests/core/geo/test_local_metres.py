"""Local metres agree with geodesics."""

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
    # PROJ treats an origin within about 1e-10 rad of the equator or of 0° as exactly there: 0.7 mm.
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
    # PROJ treats a point within 1e-10 rad of the origin in latitude and longitude as the origin.
    at_the_origin = math.hypot(east, north) < 1e-3
    assert math.dist(back[:2], (east, north)) < (1e-3 if at_the_origin else 1e-5)


def test_what_is_no_position_is_nan():
    frame = LocalFrame(LatLon(50, 14))
    assert np.isnan(frame.enu_from_latlon([(95, 14), (np.nan, 14), (50, np.inf)])).all()
    assert np.isnan(frame.latlon_from_enu([(np.nan, 0), (0, np.inf)])).all()
    assert np.isfinite(frame.enu_from_latlon([(51, 14)])).all()


WKT = (
    'PROJCS["Mercator",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Mercator_1SP"],'
    'PARAMETER["central_meridian",0],PARAMETER["scale_factor",1],PARAMETER["false_easting",0],'
    'PARAMETER["false_northing",0],UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)


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


@pytest.mark.parametrize(
    "name",
    [
        "+proj=utm +zone=33 +nadgrids=/proc/self/fd/6 +no_defs",
        "+proj=utm +zone=33 +nadgrids=@null,/proc/self/fd/6",
        "+proj=utm +zone=33 +datum=WGS84 +geoidgrids=grid.tif",
        "+init=/etc/passwd:section",
        "init=epsg:32633",
        "/etc/passwd:section",
        "+proj=pipeline +step +proj=hgridshift +grids=grid.tif",
        WKT.replace('AXIS["Easting"', 'EXTENSION["PROJ4","+proj=merc +nadgrids=/tmp/grid"],AXIS["Easting"'),
        WKT.replace("Mercator_1SP", "PROJ-based operation method: +proj=hgridshift +grids=/tmp/grid"),
        WKT.replace("Mercator_1SP", "PROJ hgridshift"),
        WKT.replace('PARAMETER["scale_factor",1]', 'PARAMETERFILE["grids","/tmp/grid"]'),
        WKT.replace("Mercator_1SP", "a" * 20_000),
        '{"type": "ProjectedCRS"}',
    ],
)
def test_what_could_name_a_file_never_reaches_proj(name, monkeypatch):
    """PROJ would open the file: any file of the machine, or a pipe of the server."""
    monkeypatch.setattr("pyproj.CRS", None)
    with pytest.raises(GeoreferenceError, match="unknown coordinate system"):
        parse_crs(name)


@pytest.mark.parametrize(
    "name",
    [
        "epsg:32633",
        "ESRI:102067",
        "OGC:CRS84",
        "+proj=tmerc +lat_0=0 +lon_0=15 +k=0.9996 +x_0=500000 +y_0=0 +ellps=bessel +towgs84=589,76,480",
        "proj=utm zone=33 datum=WGS84",
    ],
)
def test_usual_forms_are_read_and_so_is_their_wkt(name):
    crs = parse_crs(name)
    for version in ("WKT1_GDAL", "WKT2_2019"):
        assert parse_crs(crs.to_wkt(version)).name == crs.name


def test_wkt_of_the_web_is_read():
    """GDAL adds a PROJ string to it, which states that there is no grid."""
    assert 'EXTENSION["PROJ4","' in parse_crs("EPSG:3857").to_wkt("WKT1_GDAL")
    assert crs_name(parse_crs("EPSG:3857").to_wkt("WKT1_GDAL")) == "EPSG:3857"


def test_a_name_is_short_where_that_is_exact():
    assert crs_name(parse_crs("EPSG:32633").to_wkt()) == "EPSG:32633"
    local = LocalFrame(LatLon(1, 2)).plane
    assert crs_name(local) == local


def test_centre():
    assert centre_of([(10, 179), (10, -179)]).lon == pytest.approx(180)
    assert centre_of([(10, 20)]) == pytest.approx((10, 20))
    assert centre_of([(0, 0), (0, 180)]) == (0, 0)
