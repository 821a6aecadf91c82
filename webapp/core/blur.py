"""Makes parts of a picture unrecognisable: faces, number plates."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.boxes import BlurBox

_CELLS = 6
"""Mean colours along the longer side of a box; a blur with a kernel could be inverted."""


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
