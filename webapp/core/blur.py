"""Makes parts of a picture unrecognisable: faces, number plates."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_BOXES = 500
"""Of a photo: each costs time whenever the photo is shown."""

_CELLS = 6
"""Mean colours along the longer side of a box; a blur with a kernel could be inverted."""

_ROUNDING = 1e-6
"""Tolerance for rounding errors of computed shares."""


class BlurBox(NamedTuple):
    """A part of a picture, in shares of its width and height from its top-left corner."""

    x: float
    y: float
    width: float
    height: float

    @property
    def inside(self) -> bool:
        """Whether it is a part of the picture: not empty, and not beyond an edge by more than rounding."""
        most = 1 + _ROUNDING
        ends = (self.x + self.width, self.y + self.height)
        return min(self.x, self.y) >= 0 and min(self.width, self.height) > 0 and max(ends) <= most


def blur(pixels: NDArray[np.uint8], boxes: Iterable[BlurBox]) -> NDArray[np.uint8]:
    """Replace boxes by a few mean colours of each, joined smoothly.

    Args:
        pixels: (h, w, 3) uint8
        boxes: Parts outside the picture are ignored.

    Returns:
        (h, w, 3) uint8: A copy.
    """
    blurred = pixels.copy()
    height, width = pixels.shape[:2]
    for box in boxes:
        left, right = _span(box.x, box.width, width)
        top, bottom = _span(box.y, box.height, height)
        part = blurred[top:bottom, left:right]
        if part.size == 0:
            continue
        scale = min(1.0, _CELLS / max(part.shape[:2]))
        cells = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
        small = cv2.resize(np.ascontiguousarray(part), cells, interpolation=cv2.INTER_AREA)
        blurred[top:bottom, left:right] = cv2.resize(
            small, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR
        )
    return blurred


def boxes_key(boxes: Iterable[BlurBox]) -> str:
    """Return a short hash that identifies these boxes."""
    return hashlib.sha256(repr([tuple(box) for box in boxes]).encode()).hexdigest()[:12]


def outside(boxes: Iterable[BlurBox], *, width: int, height: int) -> NDArray[np.bool_]:
    """Return which pixels of a picture are in none of the boxes, (height, width)."""
    free = np.ones((height, width), np.bool_)
    for box in boxes:
        left, right = _span(box.x, box.width, width)
        top, bottom = _span(box.y, box.height, height)
        free[top:bottom, left:right] = False
    return free


def _span(start: float, length: float, size: int) -> tuple[int, int]:
    """Return first and end of the pixels that a share of a side touches."""
    first = int(np.clip(np.floor(start * size), 0, size))
    last = int(np.clip(np.ceil((start + length) * size), 0, size))
    return first, last
