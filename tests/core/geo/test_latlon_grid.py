"""A georeference sampled on a grid for pages."""

import math

import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference, latlon_grid
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon

SIZE = (5000, 4000)


def interpolate(grid, x, y):
    """Interpolate bilinearly, as the page does."""
    u, v = x / SIZE[0] * grid.columns, y / SIZE[1] * grid.rows
    i, j = min(int(u), grid.columns - 1), min(int(v), grid.rows - 1)
    u, v = u - i, v - j
    at = np.array(grid.latlon).reshape(grid.rows + 1, grid.columns + 1, 2)
    above = at[j, i] * (1 - u) + at[j, i + 1] * u
    below = at[j + 1, i] * (1 - u) + at[j + 1, i + 1] * u
    return above * (1 - v) + below * v


@pytest.mark.parametrize(
    ("plane", "matrix"),
    [
        ("EPSG:32635", (0.9, 0.3, 470683.0, 0.3, -0.9, 6696811.0, 0.0, 0.0, 1.0)),
        ("EPSG:4326", (1e-5, 0.0, 14.4, 0.0, -7e-6, 50.1, 0.0, 0.0, 1.0)),
    ],
)
def test_interpolated_to_a_few_centimetres(plane, matrix):
    georeference = Georeference(plane, matrix, "affine")
    grid = latlon_grid(georeference, SIZE)
    for x, y in [(0, 0), (5000, 4000), (1234.5, 777.0), (4999, 10), (2501, 1999)]:
        lat, lon = interpolate(grid, x, y)
        true_lat, true_lon = georeference.latlon_from_pixel([(x, y)])[0]
        metres = math.hypot(lat - true_lat, (lon - true_lon) * math.cos(math.radians(lat))) * 111_000
        assert metres < 0.03


def test_no_position_beyond_the_horizon():
    tilted = Georeference("EPSG:32635", (1.0, 0.0, 5e5, 0.0, -1.0, 6e6, 0.0, -1e-3, 1.0), "projective")
    latlon = latlon_grid(tilted, (1000, 2000), cells=4).latlon
    assert None in latlon
    assert None not in latlon[:5]


def test_longitudes_do_not_jump():
    matrix = (1.0, 0.0, -2500.0, 0.0, -1.0, 2000.0, 0.0, 0.0, 1.0)
    across = Georeference(LocalFrame(LatLon(-17.0, 180.0)).plane, matrix, "affine")
    longitudes = [lon for _, lon in latlon_grid(across, SIZE).latlon]
    assert max(longitudes) - min(longitudes) < 0.1
