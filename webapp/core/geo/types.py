"""Positions as types, so that the order of two numbers is never a guess."""

from __future__ import annotations

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
