"""Whole pixels and image borders, decided in one place."""

from __future__ import annotations

import math

from webapp.core.geo.types import MapPixel


def round_half_up(value: float) -> int:
    """Round to the nearest integer, halves upwards: 0.5 -> 1, -0.5 -> 0.

    Parameters
    ----------
    value : float
        Finite.
    """
    return math.floor(value + 0.5)


def whole_pixel(position: MapPixel) -> tuple[int, int]:
    """Give the (x, y) that a `.cfg` holds for `position`."""
    return round_half_up(position.x), round_half_up(position.y)


def inside(position: MapPixel, *, width: int, height: int) -> bool:
    """Return whether a position lies on an image of that size in pixels, borders included; NaN does not."""
    return 0 <= position.x <= width and 0 <= position.y <= height
