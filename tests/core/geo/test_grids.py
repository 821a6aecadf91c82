"""Positions in UTM, MGRS and other notations, against values from other sources."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.crs import latlon_from_plane
from webapp.core.geo.grids import decimal, degrees_minutes_seconds, mgrs, utm
from webapp.core.geo.types import LatLon

KNOWN = {
    (42.0, -93.0): "15T WG 00000 49776",
    (48.24949, 16.4145): "33U XP 05004 44998",
    (48.8581938379, 2.2944892452): "31U DQ 48251 11932",
    (-33.90772474, 151.21288644): "56H LH 34775 46637",
    (83.62738, -32.66433): "25X EN 04159 86508",
}
"""As converted by other programs; some round the metres, others truncate them."""


@pytest.mark.parametrize(("latlon", "expected"), KNOWN.items())
def test_mgrs_of_known_places(latlon, expected):
    found = mgrs(LatLon(*latlon))
    assert found.split()[:2] == expected.split()[:2]
    for result, known in zip(found.split()[2:], expected.split()[2:], strict=True):
        assert abs(int(result) - int(known)) <= 1


def test_a_position_on_a_line_of_the_grid_is_on_it():
    assert mgrs(LatLon(42.0, -93.0)) == "15T WG 00000 49776"


@pytest.mark.parametrize(
    ("lat", "lon", "zone", "band"),
    [
        (50.0, 14.4, 33, "U"),
        (60.39, 5.32, 32, "V"),  # Bergen: Norway's wide zone
        (55.9, 5.32, 31, "U"),
        (78.2, 15.6, 33, "X"),  # Longyearbyen: Svalbard has odd zones only
        (78.2, 8.9, 31, "X"),
        (78.2, 9.0, 33, "X"),
        (78.2, 35.0, 37, "X"),
        (0.0, 0.0, 31, "N"),
        (-0.0001, 0.0, 31, "M"),
        (84.0, 0.0, 31, "X"),
        (-80.0, -180.0, 1, "C"),
        (10.0, 180.0, 1, "P"),
        (10.0, 179.999, 60, "P"),
    ],
)
def test_zone_and_band(lat, lon, zone, band):
    found = utm(LatLon(lat, lon))
    assert (found.zone, found.band) == (zone, band)


@given(st.floats(-79.9, 83.9), st.floats(-180, 180))
def test_utm_leads_back(lat, lon):
    found = utm(LatLon(lat, lon))
    plane = f"EPSG:32{(700 if lat < 0 else 600) + found.zone}"
    ((lat_back, lon_back),) = latlon_from_plane(plane, [(found.easting, found.northing)])
    assert lat_back == pytest.approx(lat, abs=1e-8)
    assert abs((lon_back - lon + 180) % 360 - 180) < 1e-6 / math.cos(math.radians(lat))
    assert re.fullmatch(r"\d{1,2}[C-X] \d{6} \d{7,8}", str(found))
    assert re.fullmatch(r"\d{1,2}[C-X] [A-HJ-NP-Z][A-HJ-NP-V] \d{5} \d{5}", mgrs(LatLon(lat, lon)))


@pytest.mark.parametrize("lat", [84.01, 90.0, -80.01, float("nan")])
def test_beyond_the_grid_there_is_none(lat):
    assert utm(LatLon(lat, 10.0)) is None
    assert mgrs(LatLon(lat, 10.0)) is None


def test_degrees_as_people_write_them():
    assert decimal(LatLon(50.2104, -15.8252)) == "50.210400, -15.825200"
    assert degrees_minutes_seconds(LatLon(50.2104, 15.8252)) == "50°12'37.44\"N 15°49'30.72\"E"
    assert degrees_minutes_seconds(LatLon(-0.5, -179.9999999)) == "0°30'00.00\"S 180°00'00.00\"W"
    assert degrees_minutes_seconds(LatLon(9.99999999, 0.0)) == "10°00'00.00\"N 0°00'00.00\"E"
