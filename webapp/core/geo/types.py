"""Types of positions, which fix the order of coordinates; rounding to pixels, and image bounds."""

from __future__ import annotations

import math
from typing import NamedTuple


class LatLon(NamedTuple):
    """A position on the WGS 84 ellipsoid, degrees north and east."""

    lat: float
    lon: float


class MapPixel(NamedTuple):
    """A position on the satellite image: pixels right of its left edge, pixels below its top edge.

    (0, 0) is the outer corner of the top-left pixel; valid positions have 0 <= x <= width, 0 <= y <= height.
    """

    x: float
    y: float


class EnuMetres(NamedTuple):
    """Metres east, north and up of a local origin."""

    east: float
    north: float
    up: float = 0.0


def round_half_up(value: float) -> int:
    """Round to the nearest integer, halves upwards: 0.5 -> 1, -0.5 -> 0."""
    return math.floor(value + 0.5)


def whole_pixel(position: MapPixel) -> tuple[int, int]:
    """Return the (x, y) that a `.cfg` stores for `position`."""
    return round_half_up(position.x), round_half_up(position.y)


def inside(position: MapPixel, *, width: int, height: int) -> bool:
    """Return whether a position is on an image of that size in pixels, borders included; False for NaN."""
    return 0 <= position.x <= width and 0 <= position.y <= height
