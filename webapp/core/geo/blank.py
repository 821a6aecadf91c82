"""A blank plan, for photos with positions but without a satellite image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame, centre_of

MARGIN = 0.05
"""Margin around the positions, as a fraction of their extent."""

_LONGEST_PX = 2000
_SMALLEST_M = 50.0
_STEPS = (1.0, 2.0, 2.5, 5.0)
_BACKGROUND, _LINE, _STRONG, _INK = (240, 244, 245), (222, 228, 230), (200, 208, 212), (90, 84, 80)


@dataclass(frozen=True, slots=True)
class BlankPlan:
    """Size and position of a blank plan; north is up."""

    georeference: Georeference
    # `width`, `height`: Pixels.
    width: int
    height: int
    metres_per_pixel: float
    # `east_m`, `north_m`: Of the top-left corner, metres from the plan's own origin.
    east_m: float
    north_m: float


def plan_around(latlon: ArrayLike) -> BlankPlan:
    """Return a plan around positions, with a margin of 5 % of their extent on each side.

    Args:
        latlon: (n, 2) float64. At least one position; degrees north, degrees east. Extents below 50 m give a
            plan of 50 m x 50 m.

    Returns:
        The longer side has 1000 to 2000 pixels of a round size in metres, the shorter at least half as many.
    """
    frame = LocalFrame(centre_of(latlon))
    enu = frame.enu_from_latlon(latlon)
    low, high = enu.min(axis=0), enu.max(axis=0)
    extent = (high - low) * (1.0 + 2.0 * MARGIN)
    longest = max(float(extent.max()), _SMALLEST_M)
    extent = np.maximum(extent, longest / 2.0 if extent.max() > _SMALLEST_M else longest)
    scale = round_up(longest / _LONGEST_PX)
    width, height = (math.ceil(side / scale) for side in extent.tolist())
    middle = (low + high) / 2.0
    east, north = float(middle[0] - width * scale / 2.0), float(middle[1] + height * scale / 2.0)
    matrix = (scale, 0.0, east, 0.0, -scale, north, 0.0, 0.0, 1.0)
    return BlankPlan(Georeference(frame.plane, matrix, "blank"), width, height, scale, east, north)


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 2.5 or 5 times a power of ten that is at least a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next((step * power for step in _STEPS if step * power >= value * (1 - 1e-12)), 10.0 * power)


def draw(plan: BlankPlan) -> NDArray[np.uint8]:
    """Draw a plan: light background, a grid in metres, a scale bar and a north arrow.

    Returns:
        (height, width, 3) uint8: Blue, green, red.
    """
    image = np.full((plan.height, plan.width, 3), _BACKGROUND, dtype=np.uint8)
    step = round_up(max(plan.width, plan.height) * plan.metres_per_pixel / 20.0)
    for axis, (start, direction) in enumerate(((plan.east_m, 1.0), (plan.north_m, -1.0))):
        length = (plan.width, plan.height)[axis] * plan.metres_per_pixel
        first, last = sorted((start, start + direction * length))
        for k in range(math.ceil(first / step), math.floor(last / step) + 1):
            at = round((k * step - start) * direction / plan.metres_per_pixel)
            line = (slice(None), slice(at, at + 1)) if axis == 0 else (slice(at, at + 1), slice(None))
            image[line] = _STRONG if k % 5 == 0 else _LINE
    _scale_bar(image, step, plan.metres_per_pixel)
    _north_arrow(image)
    return image


def draw_sheet(width: int, height: int) -> NDArray[np.uint8]:
    """Draw a plan without a position on the Earth: light background with a grid in pixels.

    Returns:
        (height, width, 3) uint8: Blue, green, red.
    """
    image = np.full((height, width, 3), _BACKGROUND, dtype=np.uint8)
    step = int(round_up(max(width, height) / 20.0))
    for k in range(math.ceil(max(width, height) / step)):
        image[:, k * step : k * step + 1] = image[k * step : k * step + 1] = _STRONG if k % 5 == 0 else _LINE
    return image


def _scale_bar(image: NDArray[np.uint8], step_m: float, metres_per_pixel: float) -> None:
    left, bottom, length = 20, image.shape[0] - 20, round(step_m * 2.0 / metres_per_pixel)
    cv2.line(image, (left, bottom), (left + length, bottom), _INK, 2)
    for x in (left, left + length):
        cv2.line(image, (x, bottom - 6), (x, bottom + 6), _INK, 2)
    metres = step_m * 2.0
    label = f"{metres / 1000:g} km" if metres >= 1000.0 else f"{metres:g} m"
    cv2.putText(image, label, (left + 8, bottom - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)


def _north_arrow(image: NDArray[np.uint8]) -> None:
    x = image.shape[1] - 30
    cv2.arrowedLine(image, (x, 70), (x, 30), _INK, 2, cv2.LINE_AA, tipLength=0.3)
    cv2.putText(image, "N", (x - 6, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INK, 1, cv2.LINE_AA)
