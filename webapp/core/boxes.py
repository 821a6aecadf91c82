"""Parts of a picture to blur, and the hash that identifies them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import NamedTuple

MOST_BOXES = 500
"""Of a photo: each costs time whenever the photo is shown."""

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


def boxes_key(boxes: Iterable[BlurBox]) -> str:
    """Return a short hash that identifies these boxes."""
    return hashlib.sha256(repr([tuple(box) for box in boxes]).encode()).hexdigest()[:12]
