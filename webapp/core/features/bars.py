"""Finds uniform bars around a photo, as in screenshots and in videos of another shape."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SAME = 6
"""Largest difference of grey values within a bar."""

_UNIFORM = 0.85
"""Least share of a line's pixels in the colour of the bar: a status line has a clock and icons."""

_CHANGED = 0.5
"""A bar ends where at least this share of the pixels has another colour at once. Sky and darkness fade into
the scene, or end in a skyline."""

_WITHIN_LINES = 2
"""Lines within which it ends; a saved photo has blurred edges."""

_THINNEST, _LEAST_LEFT = 0.02, 0.25
"""Least thickness of a bar, and least side of the photo that remains, shares of the whole side."""


class Inside(NamedTuple):
    """The photo inside the bars: pixels from `left` and `top` up to `right` and `bottom`, exclusive."""

    left: int
    top: int
    right: int
    bottom: int


def inside_bars(gray: NDArray[np.uint8]) -> Inside:
    """Find the photo inside uniform bars; everything if there are none.

    Args:
        gray: (h, w) uint8
    """
    height, width = gray.shape
    top, bottom = _thickness(gray), _thickness(gray[::-1])
    if height - top - bottom < _LEAST_LEFT * height:
        top = bottom = 0
    middle = gray[top : height - bottom].T
    left, right = _thickness(middle), _thickness(middle[::-1])
    if width - left - right < _LEAST_LEFT * width:
        left = right = 0
    return Inside(left, top, width - right, height - bottom)


def _thickness(lines: NDArray[np.uint8]) -> int:
    """Count the lines of a bar at the beginning of (n, m) lines; 0 if there is none."""
    colour = int(np.median(lines[0]))
    share = (np.abs(lines.astype(np.int16) - colour) <= _SAME).mean(axis=1)
    ends = np.flatnonzero(share < _UNIFORM)
    first = int(ends[0]) if len(ends) else 0
    if first < max(_THINNEST * len(lines), 1.0):
        return 0
    inner = share[first : first + _WITHIN_LINES + 1]
    return first if float(inner.min()) <= 1.0 - _CHANGED else 0
