"""Panoramas of a map: one experience each, which is indexed as level views."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.boxes import BlurBox, boxes_key
from webapp.core.geometry.tilt import LEVEL, Tilt

VIEWS = 6
"""Number of views of a panorama, evenly spaced all around; the first looks towards its middle."""

FOCAL_35MM = 17
"""35 mm equivalent focal length of each view, mm: 91 degrees wide, so that neighbours overlap."""

_NUMBER = 2**32
"""The id of a view is that of its panorama plus a multiple of this, which is above all ids of a map."""

_MOST_CELLS = (360, 180)
"""Largest number of columns and rows of a mask: one per degree."""

_DIGITS = 5
"""Decimals of the edges of boxes: a tenth of a pixel of a wide panorama."""


@dataclass(frozen=True, slots=True)
class Panorama:
    """A photo that shows the whole sphere; its heading is that of its middle."""

    masked: tuple[BlurBox, ...] = ()  # Parts that are not used for recognition: the robot, the sky
    tilt: Tilt = LEVEL

    def views(self) -> tuple[LevelView, ...]:
        return tuple(LevelView(round(360.0 * n / VIEWS), self.masked, self.tilt) for n in range(VIEWS))


@dataclass(frozen=True, slots=True)
class LevelView:
    turn_deg: int  # Clockwise turn from the middle of the panorama
    masked: tuple[BlurBox, ...] = ()  # Masked parts of the panorama
    tilt: Tilt = LEVEL  # Of the panorama

    @property
    def key(self) -> str:
        """Key that distinguishes it from other views of the same file."""
        masked = f"-{boxes_key(self.masked)}" if self.masked else ""
        tilt = "" if self.tilt.is_level else f"-{self.tilt.pitch_deg:g},{self.tilt.roll_deg:g}"
        return f"{self.turn_deg:03}{masked}{tilt}"

    def content(self, sha256: str) -> str:
        """Return a hash that identifies its pixels, as the SHA-256 of the file does for a photo."""
        return hashlib.sha256(f"{sha256} {self.key}".encode()).hexdigest()


def view_id(experience: int, number: int) -> int:
    """Return the id of a view of an experience; views are numbered from 0."""
    return experience + (number + 1) * _NUMBER


def experience_of(id: int) -> int:
    """Return the id of the experience of a view; the id of any other photo is returned unchanged."""
    return id % _NUMBER


def experiences_of(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    return ids % _NUMBER


def band(*, lowest_deg: float = 90.0, highest_deg: float = 90.0) -> tuple[BlurBox, ...]:
    """Mask the parts that are farther below or above the horizon."""
    boxes = []
    if highest_deg < 90.0:
        boxes.append(BlurBox(0.0, 0.0, 1.0, (90.0 - highest_deg) / 180.0))
    if lowest_deg < 90.0:
        top = (90.0 + lowest_deg) / 180.0
        boxes.append(BlurBox(0.0, top, 1.0, 1.0 - top))
    return tuple(boxes)


def boxes_of_mask(used: NDArray[np.bool_]) -> tuple[BlurBox, ...]:
    """Cover the unused part of a mask by boxes.

    Args:
        used: (h, w) bool. Of the whole panorama: the part to use. It is sampled to cells of at least one
            degree and one pixel; a cell that is partly unused counts as unused.
    """
    rows, columns = (min(own, most) for own, most in zip(used.shape, _MOST_CELLS[::-1], strict=True))
    high, wide = used.shape
    strips = np.logical_and.reduceat(used, -(-np.arange(rows) * high // rows), axis=0)
    out = ~np.logical_and.reduceat(strips, -(-np.arange(columns) * wide // columns), axis=1)
    runs = ((row, *run) for row in range(rows) for run in _runs(out[row]))
    return tuple(
        _rounded(first / columns, top / rows, right=last / columns, bottom=bottom / rows)
        for top, bottom, first, last in _stacked(runs)
    )


def _rounded(left: float, top: float, *, right: float, bottom: float) -> BlurBox:
    x, y = round(left, _DIGITS), round(top, _DIGITS)
    return BlurBox(x, y, round(right - x, _DIGITS), round(bottom - y, _DIGITS))


def _runs(row: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Find the runs of true cells in a row: the first one, and the one after the last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _stacked(runs: Iterable[tuple[int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Merge equal runs of consecutive rows: top, bottom, first and last column."""
    open_: dict[tuple[int, int], tuple[int, int]] = {}
    done = []
    for row, first, last in runs:
        top, bottom = open_.get((first, last), (row, row))
        if bottom != row:
            done.append((top, bottom, first, last))
            top = row
        open_[first, last] = top, row + 1
    done += [(top, bottom, *columns) for columns, (top, bottom) in open_.items()]
    return sorted(done)
