"""Georeference from corners."""

import json

import numpy as np
import pytest
from pyproj import Geod

from webapp.core.geo.fit import Corners, from_corners
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError
from webapp.files.decode import image_size
from webapp.files.satellite.georeference_files import read_corners

NW, SE = LatLon(60.41, 22.46), LatLon(60.40, 22.48)
SIZE = {"width": 1100, "height": 1114}


def test_two_corners_are_linear_in_degrees():
    g = from_corners(Corners(NW, SE), **SIZE).georeference
    assert g.latlon_of(MapPixel(0, 0)) == NW
    assert g.latlon_of(MapPixel(1100, 1114)) == pytest.approx(SE, abs=1e-12)
    assert g.latlon_of(MapPixel(275, 557)) == pytest.approx((60.405, 22.465), abs=1e-12)
    assert g.north_deg(MapPixel(500, 500)) == pytest.approx(0, abs=1e-9)


def test_the_shared_satellite_image_to_a_millimetre(shared_data):
    folder = shared_data / "satellite"
    width, height = image_size(folder / "satellite.png")
    fit = from_corners(read_corners(folder / "corners.json"), width=width, height=height)
    stated = json.loads((folder / "corners.json").read_text(encoding="utf-8"))
    left, right = stated["top_left"]["lon"], stated["bottom_right"]["lon"]
    top, bottom = stated["top_left"]["lat"], stated["bottom_right"]["lat"]
    xy = np.random.default_rng(2).uniform(0, 1, (500, 2)) * (width, height)
    lon = left + (right - left) * xy[:, 0] / width
    lat = top + (bottom - top) * xy[:, 1] / height
    found = fit.georeference.latlon_from_pixel(xy)
    assert np.max(Geod(ellps="WGS84").inv(lon, lat, found[:, 1], found[:, 0])[2]) < 1e-3
    assert np.abs(fit.georeference.pixel_from_latlon(found) - xy).max() < 1e-4
    centre = MapPixel(width / 2, height / 2)
    assert fit.georeference.metres_per_pixel(centre) == pytest.approx(0.136, abs=0.001)
    assert fit.warnings == ()


def test_four_corners_of_a_rectangle_say_the_same_as_two():
    two = from_corners(Corners(NW, SE), **SIZE).georeference
    four = Corners(NW, SE, top_right=LatLon(60.41, 22.48), bottom_left=LatLon(60.40, 22.46))
    pixels = np.random.default_rng(3).uniform(-100, 1200, (100, 2))
    found = from_corners(four, **SIZE).georeference.latlon_from_pixel(pixels)
    assert found == pytest.approx(two.latlon_from_pixel(pixels), abs=1e-11)


def test_four_corners_of_a_turned_and_tilted_image():
    corners = Corners(
        LatLon(50.002, 14.001), LatLon(50.0, 14.004), LatLon(50.003, 14.004), LatLon(50.0005, 14.0)
    )
    g = from_corners(corners, width=800, height=600).georeference
    for pixel, position in (
        ((0, 0), corners.top_left),
        ((800, 0), corners.top_right),
        ((800, 600), corners.bottom_right),
        ((0, 600), corners.bottom_left),
    ):
        assert g.latlon_of(MapPixel(*pixel)) == pytest.approx(position, abs=1e-11)
    # lines stay straight: the diagonals intersect in one point
    middle = g.pixel_of(g.latlon_of(MapPixel(400, 300)))
    assert middle == pytest.approx((400, 300), abs=1e-6)
    assert abs(g.north_deg(middle)) > 1


def test_across_the_180th_meridian():
    g = from_corners(Corners(LatLon(10.1, 179.9), LatLon(9.9, -179.9)), width=1000, height=1000).georeference
    assert g.pixel_of(LatLon(10.0, -179.95)) == pytest.approx((750, 500), abs=1e-6)
    assert g.pixel_of(LatLon(10.0, 179.95)) == pytest.approx((250, 500), abs=1e-6)
    assert g.latlon_of(MapPixel(750, 500)) == pytest.approx((10.0, -179.95), abs=1e-9)


def test_the_whole_world():
    g = from_corners(Corners(LatLon(90, -180), LatLon(-90, 180)), width=3600, height=1800).georeference
    assert g.pixel_of(LatLon(0, 170)) == pytest.approx((3500, 900))


@pytest.mark.parametrize(
    ("corners", "part"),
    [
        (Corners(SE, NW), "swapped"),
        (Corners(LatLon(60.40, 22.46), LatLon(60.41, 22.48)), "north-west"),
        (Corners(LatLon(60.41, 22.48), LatLon(60.40, 22.46)), "north-west"),
        (Corners(NW, NW), "opposite"),
        (Corners(NW, LatLon(60.41, 22.48)), "opposite"),
        (Corners(NW, SE, LatLon(60.41, 22.48)), "all four"),
        (Corners(LatLon(112.46, 60.41), LatLon(112.48, 60.40)), "swapped"),
        (Corners(NW, LatLon(float("nan"), 22.48)), "-90 to 90"),
        (Corners(NW, LatLon(60.40, 222.0)), "-180 to 180"),
        (Corners(NW, SE, LatLon(60.40, 22.46), LatLon(60.41, 22.48)), None),
        (Corners(NW, SE, NW, SE), "four corners"),
        (Corners(NW, SE, LatLon(60.405, 22.47), LatLon(60.4025, 22.475)), "one line"),
        (Corners(NW, LatLon(60.41, 22.48), SE, LatLon(60.40, 22.46)), None),
    ],
)
def test_impossible_corners_are_refused(corners, part):
    with pytest.raises(GeoreferenceError) as caught:
        from_corners(corners, **SIZE)
    assert caught.value.hint
    assert part is None or part in caught.value.hint


def test_swapped_degrees_that_are_in_range_are_suspected():
    # the same place with latitude and longitude swapped, corners still north-west and south-east
    fit = from_corners(Corners(LatLon(22.48, 60.40), LatLon(22.46, 60.41)), **SIZE)
    assert "swapped" in fit.warnings[0]
    assert from_corners(Corners(NW, SE), **SIZE).warnings == ()
