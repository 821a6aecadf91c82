"""Panoramas of a map: one experience each, which the index sees as level views."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.blur import BlurBox, boxes_key

VIEWS = 6
"""Of a panorama, evenly all around; the first looks where its middle does."""

FOCAL_35MM = 17
"""Of each, in 35 mm film, mm: 91 degrees, so that neighbours overlap."""

_NUMBER = 2**32
"""Ids of views are those of their panoramas plus a multiple of this, which no id of a map reaches."""

_MOST_CELLS = (360, 180)
"""Columns and rows of a mask at most: a degree each."""

_DIGITS = 5
"""Of the edges of boxes: a tenth of a pixel of a wide panorama."""


@dataclass(frozen=True, slots=True)
class Panorama:
    """What is known of a photo that shows the whole sphere; its heading is where its middle looks.

    Attributes
    ----------
    masked : tuple of BlurBox
        Parts in which nothing is recognised: the robot, the sky.
    """

    masked: tuple[BlurBox, ...] = ()

    def views(self) -> tuple[LevelView, ...]:
        """Return the level views that it is cut into."""
        return tuple(LevelView(round(360.0 * n / VIEWS), self.masked) for n in range(VIEWS))


@dataclass(frozen=True, slots=True)
class LevelView:
    """A level perspective view of a panorama.

    Attributes
    ----------
    turn_deg : int
        By how much it is turned clockwise from the middle of the panorama.
    masked : tuple of BlurBox
        Parts of the panorama.
    """

    turn_deg: int
    masked: tuple[BlurBox, ...] = ()

    @property
    def key(self) -> str:
        """What sets it apart from other views of the same file."""
        return f"{self.turn_deg:03}" if not self.masked else f"{self.turn_deg:03}-{boxes_key(self.masked)}"

    def content(self, sha256: str) -> str:
        """Return what stands for its pixels, as the SHA-256 of a file does for a photo's."""
        return hashlib.sha256(f"{sha256} {self.key}".encode()).hexdigest()


def view_id(experience: int, number: int) -> int:
    """Return the id of a view of an experience; they are numbered from 0."""
    return experience + (number + 1) * _NUMBER


def experience_of(id: int) -> int:
    """Return the id of the experience that a view is of; that of any other photo is its own."""
    return id % _NUMBER


def experiences_of(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the ids of the experiences that photos or views belong to."""
    return ids % _NUMBER


def band(*, lowest_deg: float = 90.0, highest_deg: float = 90.0) -> tuple[BlurBox, ...]:
    """Mask what is farther below or above the horizon."""
    boxes = []
    if highest_deg < 90.0:
        boxes.append(BlurBox(0.0, 0.0, 1.0, (90.0 - highest_deg) / 180.0))
    if lowest_deg < 90.0:
        top = (90.0 + lowest_deg) / 180.0
        boxes.append(BlurBox(0.0, top, 1.0, 1.0 - top))
    return tuple(boxes)


def boxes_of_mask(used: NDArray[np.bool_]) -> tuple[BlurBox, ...]:
    """Cover what a mask leaves out by boxes.

    Parameters
    ----------
    used : (h, w) bool
        Of the whole panorama: what is recognised. A cell of which a part is left out is left out as a whole;
        there is one a degree, or fewer of a smaller mask.
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
    """Find the runs of true cells of a row: the first, and the one behind the last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _stacked(runs: Iterable[tuple[int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Join equal runs of rows that follow each other: top, bottom, first and last column."""
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
