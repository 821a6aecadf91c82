"""The share of a search area that tracks have passed within a radius.

The area is sampled by a regular grid of points, each tested exactly against the track, so that the estimate
has no bias at the edges. The grid has a few points per radius, but at most `_MOST_SAMPLES`: of an area
kilometres across, a single narrow track is counted roughly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from webapp.missions.core.trajectory.thinning import GAP_FACTOR, GAP_S

_Metres = NDArray[np.float64]

_MOST_SAMPLES = 4_000_000
_PER_RADIUS = 6.0
"""Samples per radius."""
_ACROSS = 64.0
"""Samples across a small area, at least."""
_STEP = 0.25
"""Distance of the points into which the line of a track is divided, in radii: the union of their discs is
narrower than the strip along the line by less than one per cent."""
_SNAP = 0.02
"""Points closer than this, in radii, count as one: a robot that stands still sends many."""


@dataclass(slots=True)
class Coverage:
    """Covered samples of an area; tracks are added block by block.

    Args:
        outline: (n, 2) float64. Corners of the area, metres.
    """

    outline: _Metres
    radius_m: float
    _corner: _Metres = field(init=False)
    _cell: float = field(init=False)
    # (rows, columns / 8) uint8: a bit for each sample, as there are millions
    _inside: NDArray[np.uint8] = field(init=False)
    _covered: NDArray[np.uint8] = field(init=False)
    _shape: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        """Lay the grid."""
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        width, height = (high - low).tolist()
        fine = min(self.radius_m / _PER_RADIUS, max(width, height) / _ACROSS)
        self._cell = max(
            fine, float(np.sqrt(width * height / _MOST_SAMPLES)), max(width, height) / _MOST_SAMPLES
        )
        columns, rows = (int(np.ceil(side / self._cell)) or 1 for side in (width, height))
        self._corner = low + self._cell / 2
        self._shape = (rows, columns)
        inside = _inside(self.outline, self._corner, cell=self._cell, shape=self._shape)
        self._inside = np.packbits(inside, axis=1)
        self._covered = np.zeros_like(self._inside)

    @property
    def samples(self) -> int:
        """Number of samples, inside the area or not."""
        return self._shape[0] * self._shape[1]

    def add(self, metres: _Metres, joined: NDArray[np.bool_]) -> None:
        """Add a part of a track.

        Args:
            metres: (m, 2) float64
            joined: (m - 1,) bool. Whether the way between a point and the next is known: a straight line.
        """
        points = self._near(_along(metres, joined, step=_STEP * self.radius_m))
        self._mark(
            (_distinct(points, min(_SNAP * self.radius_m, self._cell / 4)) - self._corner) / self._cell
        )

    @property
    def share(self) -> float | None:
        """The covered share of the area; None for one so narrow that no sample is inside."""
        samples = _count(self._inside)
        return _count(self._covered & self._inside) / samples if samples else None

    def _near(self, points: _Metres) -> _Metres:
        low, high = self.outline.min(axis=0) - self.radius_m, self.outline.max(axis=0) + self.radius_m
        near: _Metres = points[((points >= low) & (points <= high)).all(axis=1)]
        return near

    def _mark(self, at: _Metres) -> None:
        """Mark the samples within the radius of points, in cells: in each row they are a run."""
        reach, (rows, columns) = self.radius_m / self._cell, self._shape
        edges = np.zeros((rows, columns + 1), dtype=np.int32)
        nearest = np.floor(at[:, 1]).astype(np.int64)
        offsets = range(-int(reach) - 1, int(reach) + 3)
        fewer = len(offsets) < rows
        for number in offsets if fewer else range(rows):
            row = nearest + number if fewer else np.full(len(at), number)
            left = reach**2 - (row - at[:, 1]) ** 2
            known = (left >= 0) & (row >= 0) & (row < rows)
            half = np.sqrt(left[known])
            first = np.clip(np.ceil(at[known, 0] - half), 0, columns).astype(np.int64)
            stop = np.clip(np.floor(at[known, 0] + half) + 1, 0, columns).astype(np.int64)
            some = first < stop
            np.add.at(edges, (row[known][some], first[some]), 1)
            np.add.at(edges, (row[known][some], stop[some]), -1)
        self._covered |= np.packbits(np.cumsum(edges, axis=1)[:, :-1] > 0, axis=1)


def _count(bits: NDArray[np.uint8]) -> int:
    return int(np.bitwise_count(bits).sum(dtype=np.int64))


def joined_by_time(times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return between which poses the way is known: not across gaps, nor where time goes backwards.

    A gap is one as in `webapp.missions.core.trajectory.thinning`.

    Returns:
        (n - 1,) bool
    """
    waits = np.diff(times_s)
    gap_s = max(GAP_S, GAP_FACTOR * float(np.median(waits))) if len(waits) else GAP_S
    return (waits >= 0) & (waits <= gap_s)


def _along(metres: _Metres, joined: NDArray[np.bool_], *, step: float) -> _Metres:
    """Return the points of a track, and points at most `step` apart on its known ways."""
    if len(metres) < 2:
        return metres
    ways = np.diff(metres, axis=0)
    counts = np.where(joined, np.ceil(np.hypot(*ways.T) / step), 1.0).astype(np.int64)
    counts = np.maximum(counts, 1)
    owner = np.repeat(np.arange(len(ways)), counts)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (nth / counts[owner])[:, None]
    return np.concatenate([metres[owner] + share * ways[owner], metres[-1:]])


def _distinct(points: _Metres, snap: float) -> _Metres:
    """Return points on a fine grid, each once."""
    steps = np.round(points / snap).astype(np.int64)
    keys = np.unique((steps[:, 0] << 32) + (steps[:, 1] + (1 << 31)))
    return np.column_stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)]) * snap


def _inside(outline: _Metres, corner: _Metres, *, cell: float, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which samples are inside: those with an odd number of sides to the left of them."""
    rows, columns = shape
    flips = np.zeros((rows, columns + 1), dtype=np.bool_)
    points = (outline - corner) / cell
    for (x1, y1), (x2, y2) in zip(points.tolist(), np.roll(points, -1, axis=0).tolist(), strict=True):
        low, high = min(y1, y2), max(y1, y2)
        row = np.arange(max(0, int(np.ceil(low))), min(rows, int(np.ceil(high))))
        if not len(row):
            continue
        x = x1 + (row - y1) * ((x2 - x1) / (y2 - y1))
        flips[row, np.clip(np.ceil(x), 0, columns).astype(np.int64)] ^= True
    inside: NDArray[np.bool_] = np.logical_xor.accumulate(flips, axis=1)[:, :-1]
    return inside
