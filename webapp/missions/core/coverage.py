"""The share of a search area that tracks have passed within a radius.

The area is sampled by a regular grid of points, each tested exactly against the track, so that the estimate
has no bias at the edges. The grid has a few points per radius, but at most `_MOST_SAMPLES`: of an area
kilometres across, a single narrow track is counted roughly. Time and memory depend on the rows of the grid
that ways cross, not on the length of the ways.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
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
_MOST_ALONG = 65_536
"""Rows, and columns."""
_AT_ONCE = 1 << 20
"""Rows of ways that are computed at once, each by a few numbers."""


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
            fine, float(np.sqrt(width * height / _MOST_SAMPLES)), max(width, height) / _MOST_ALONG
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
        low, high = self.outline.min(axis=0) - self.radius_m, self.outline.max(axis=0) + self.radius_m
        starts, ways = _clipped(*_ways(metres, joined), low=low, high=high)
        self._mark((starts - self._corner) / self._cell, ways / self._cell)

    def empty(self) -> Coverage:
        """Return the same grid with nothing covered."""
        other = copy.copy(self)
        other._covered = np.zeros_like(self._covered)
        return other

    def include(self, other: Coverage) -> None:
        """Add what was covered on a grid made by `empty`."""
        self._covered |= other._covered

    def is_near(self, metres: _Metres) -> NDArray[np.bool_]:
        """Return which points, (m, 2) float64, are in the area or within the radius of it; (m,) bool."""
        low, high = self.outline.min(axis=0) - self.radius_m, self.outline.max(axis=0) + self.radius_m
        near = ((metres >= low) & (metres <= high)).all(axis=1)
        some = metres[near]
        odd, close = np.zeros(len(some), np.bool_), np.zeros(len(some), np.bool_)
        for begin, end in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
            side, off = end - begin, some - begin
            crosses = (begin[1] <= some[:, 1]) != (end[1] <= some[:, 1])
            x = off[:, 1] * (side[0] / side[1]) if side[1] else off[:, 0]
            odd ^= crosses & (x < off[:, 0])
            along = np.clip(off @ side / (side @ side), 0, 1)
            close |= np.hypot(*(off - along[:, None] * side).T) <= self.radius_m
        near[near] = odd | close
        return np.asarray(near, np.bool_)

    @property
    def share(self) -> float | None:
        """The covered share of the area; None for one so narrow that no sample is inside."""
        samples = _count(self._inside)
        return _count(self._covered & self._inside) / samples if samples else None

    def _mark(self, starts: _Metres, ways: _Metres) -> None:
        """Mark the samples within the radius of straight ways, in cells: in each row they are a run."""
        reach, (rows, columns) = self.radius_m / self._cell, self._shape
        y, dy = starts[:, 1], ways[:, 1]
        first = np.clip(np.ceil(y + np.minimum(dy, 0) - reach), 0, rows).astype(np.int64)
        stop = np.clip(np.floor(y + np.maximum(dy, 0) + reach) + 1, 0, rows).astype(np.int64)
        counts = np.maximum(stop - first, 0)
        if not counts.any():
            return
        top, bottom = int(first[counts > 0].min()), int(stop[counts > 0].max())
        edges = np.zeros((bottom - top, columns + 1), dtype=np.int32)
        for some in _parts(counts):
            owner = np.repeat(np.arange(some.start, some.stop), counts[some])
            begins = np.cumsum(counts[some]) - counts[some]
            row = first[owner] + np.arange(len(owner)) - np.repeat(begins, counts[some])
            left, right = _run(starts[owner], ways[owner], row=row, reach=reach)
            begin = np.clip(np.ceil(left), 0, columns).astype(np.int64)
            end = np.clip(np.floor(right) + 1, 0, columns).astype(np.int64)
            some_in = begin < end
            np.add.at(edges, (row[some_in] - top, begin[some_in]), 1)
            np.add.at(edges, (row[some_in] - top, end[some_in]), -1)
        marked = np.cumsum(edges, axis=1, dtype=np.int32)[:, :-1] > 0
        self._covered[top:bottom] |= np.packbits(marked, axis=1)


def _parts(counts: NDArray[np.int64]) -> Iterator[slice]:
    """Divide ways by the rows that they cross, `_AT_ONCE` together if each crosses fewer."""
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        before = int(ends[begin - 1]) if begin else 0
        end = max(int(np.searchsorted(ends, before + _AT_ONCE, side="right")), begin + 1)
        yield slice(begin, end)
        begin = end


def _run(
    starts: _Metres, ways: _Metres, *, row: NDArray[np.int64], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the samples of a row begin and end that are within reach of a way; all in cells.

    The point of the way, `t` from 0 to 1, whose disc reaches farthest in the row is where the disc's edge is
    parallel to the way, or as near to it as the discs that meet the row and the ends of the way allow.

    Returns:
        Columns, (n,) float64 each; an end before its begin where no disc meets the row.
    """
    (x, y), (dx, dy) = starts.T, ways.T
    above = row - y
    flat = np.abs(dy) < 1e-9 * reach
    slope = np.where(flat, 1.0, dy)
    at_edges = np.array([(above - reach) / slope, (above + reach) / slope])
    least, most = at_edges.min(axis=0), at_edges.max(axis=0)
    meets = np.where(flat, np.abs(above) <= reach, (least <= 1) & (most >= 0))
    least, most = np.where(flat, 0.0, np.clip(least, 0, 1)), np.where(flat, 1.0, np.clip(most, 0, 1))
    parallel = reach * np.sign(slope) * dx / np.maximum(np.hypot(dx, slope), 1e-300)
    runs = []
    for side in (-1.0, 1.0):
        t = np.where(flat, side * dx > 0, (above + side * parallel) / slope)
        t = np.clip(t, least, most)
        half = np.sqrt(np.maximum(reach**2 - (above - t * dy) ** 2, 0.0))
        runs.append(x + t * dx + side * half)
    return np.where(meets, runs[0], np.inf), np.where(meets, runs[1], -np.inf)


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


def _ways(metres: _Metres, joined: NDArray[np.bool_]) -> tuple[_Metres, _Metres]:
    """Return the begins of the known ways of a track, and the ways: (0, 0) at points without one."""
    alone = ~(np.append(joined, False) | np.append(False, joined))
    starts = np.concatenate([metres[:-1][joined], metres[alone]])
    return starts, np.concatenate([np.diff(metres, axis=0)[joined], np.zeros((int(alone.sum()), 2))])


def _clipped(starts: _Metres, ways: _Metres, *, low: _Metres, high: _Metres) -> tuple[_Metres, _Metres]:
    """Return the parts of ways that are within a rectangle (Liang and Barsky)."""
    still = ways == 0
    slope = np.where(still, 1.0, ways)
    at_edges = np.array([(low - starts) / slope, (high - starts) / slope])
    outside = still & ((starts < low) | (starts > high))
    enter = np.where(still, 0.0, at_edges.min(axis=0)).max(axis=1).clip(min=0.0)
    leave = np.where(still, 1.0, at_edges.max(axis=0)).min(axis=1).clip(max=1.0)
    near = (enter <= leave) & ~outside.any(axis=1)
    enter, leave = enter[near, None], leave[near, None]
    return starts[near] + enter * ways[near], (leave - enter) * ways[near]


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
