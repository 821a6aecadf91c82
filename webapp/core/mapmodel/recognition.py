"""How well each part of a map is recognised, in each direction, with what is not known of it.

The share of photos that are recognised is a field over places and directions. Trials, the map's own photos
that were looked for as if they were not on it, are successes and failures at some points of the field. Each
counts around its point by a kernel of distance and angle, as in R. Goetschalckx, P. Poupart and J. Hoey,
"Continuous correlated beta processes" (IJCAI 2011): at every point the share has a beta distribution, to
which the trials add their weighted successes and failures.

The prior is what the photos promise by where they are: a photo recognises one taken at its own place in its
own direction with the probability `RECOGNISES`, less by the same kernel farther off, and several photos do so
independently of each other (a noisy OR: J. Pearl, "Probabilistic Reasoning in Intelligent Systems", 1988). It
weighs as much as one trial. Without trials it is all there is, and the standard deviation says so. A trial
whose direction is not known counts for all directions; a photo whose direction is not known has one of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIRECTIONS = 8
"""North, north-east and so on, clockwise."""

STEP_DEG = 360.0 / DIRECTIONS

RECOGNISES = 0.8
"""Probability that a photo is recognised by one of the same place and direction."""

_ANGLE_SIGMA_DEG = 30.0
"""Photos with the usual field of view of 60 to 70 degrees that are turned by 45 share a third of it."""

_PRIOR_TRIALS = 1.0
_LEAST = 0.05
"""Neither success nor failure is ever certain before it was tried."""

_CELLS_PER_LENGTH = 2.0
_MOST_CELLS = 1500
_COARSER = 1.25


@dataclass(frozen=True, slots=True, eq=False)
class PhotoTrials:
    """The photos of a map, and which of them were recognised when they were hidden.

    Attributes
    ----------
    position : (n, 2) float64
        On the image, in units of the same length everywhere.
    heading_deg : (n,) float64
        Clockwise from north; NaN where it is not known.
    success : (n,) float64
        Between 0 and 1; NaN for a photo that was not tried.
    """

    position: Array
    heading_deg: Array
    success: Array


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Sides parallel to the image's, in the units of the photos."""

    left: float
    top: float
    right: float
    bottom: float

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points, (n, 2), are inside."""
        low, high = (self.left, self.top), (self.right, self.bottom)
        return np.asarray(((points >= low) & (points <= high)).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class RecognitionGrid:
    """The field on square cells, those near photos and those of the area that is asked about.

    Attributes
    ----------
    cell : (c, 2) float64
        Their middles.
    side : float
        Of a cell.
    length : float
        Standard deviation of the kernel of distance.
    mean, sigma : (c, DIRECTIONS) float64
        Of the share of photos that are recognised.
    wanted : (c,) bool
        Cells of the area.
    """

    cell: Array
    side: float
    length: float
    mean: Array
    sigma: Array
    wanted: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Mean over the area; 0 for an empty one."""
        return float(self.mean[self.wanted].mean()) if self.wanted.any() else 0.0


def estimate_recognition(
    photos: PhotoTrials, *, length: float, image: Rectangle, area: Rectangle | None = None
) -> RecognitionGrid:
    """Estimate the field within `length` of photos and in the area, never outside of the image.

    Parameters
    ----------
    length : float
        How far a photo speaks for places around it: the place radius.
    area : Rectangle, optional
        That is asked about; by default all that is near photos.
    """
    side, index = _cells(photos.position, length=length, image=image, area=area)
    cell = _middles(index, side)
    length = max(length, side)
    wanted = np.ones(len(cell), np.bool_) if area is None else area.holds(cell)
    towards = _directions(photos.heading_deg)
    own = _cell_numbers(index, photos.position, side)
    near = own >= 0
    count = np.zeros((len(cell), DIRECTIONS))
    np.add.at(count, own[near], towards[near])
    prior = np.clip(_promised(cell, count, length=length), _LEAST, 1.0 - _LEAST)
    tried = np.isfinite(photos.success)
    at = distance_kernel(cell, photos.position[tried], length=length)
    around = np.where(np.isfinite(photos.heading_deg[tried, None]), towards[tried] @ angle_kernel(), 1.0)
    success = photos.success[tried, None]
    won = _PRIOR_TRIALS * prior + at @ (around * success)
    lost = _PRIOR_TRIALS * (1.0 - prior) + at @ (around * (1.0 - success))
    total = won + lost
    mean = won / total
    return RecognitionGrid(cell, side, length, mean, np.sqrt(mean * (1.0 - mean) / (total + 1.0)), wanted)


def distance_kernel(first: Array, second: Array, *, length: float) -> Array:
    """Weight each of two sets of points, (n, 2) and (m, 2), for each other; (n, m), 1 at the same place."""
    squared = ((first[:, None, :] - second[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(np.exp(-squared / (2.0 * length**2)))


def angle_kernel() -> Array:
    """Weight each direction for each other; symmetric, 1 on the diagonal."""
    steps = np.arange(DIRECTIONS)
    apart = (steps[:, None] - steps + DIRECTIONS / 2) % DIRECTIONS - DIRECTIONS / 2
    return np.asarray(np.exp(-((apart * STEP_DEG) ** 2) / (2.0 * _ANGLE_SIGMA_DEG**2)))


def _promised(cell: Array, count: Array, *, length: float) -> Array:
    """Compute the noisy OR of photos, which are counted by cell and direction; (c, DIRECTIONS)."""
    at, around = distance_kernel(cell, cell, length=length), angle_kernel()[0]
    missed = np.zeros_like(count)
    for turn in range(DIRECTIONS):
        missed += np.log1p(-RECOGNISES * around[turn] * at) @ np.roll(count, turn, axis=1)
    return np.asarray(1.0 - np.exp(missed))


def _directions(heading_deg: Array) -> Array:
    """Share each photo out between the directions next to its heading, or between all; (n, DIRECTIONS)."""
    shares = np.full((len(heading_deg), DIRECTIONS), 1.0 / DIRECTIONS)
    known = np.flatnonzero(np.isfinite(heading_deg))
    turns = heading_deg[known] % 360.0 / STEP_DEG
    below = np.floor(turns).astype(int)
    shares[known] = 0.0
    shares[known, below % DIRECTIONS] = 1.0 - (turns - below)
    shares[known, (below + 1) % DIRECTIONS] += turns - below
    return shares


def _cells(
    position: Array, *, length: float, image: Rectangle, area: Rectangle | None
) -> tuple[float, NDArray[np.int64]]:
    """Choose the cells' side, and number their columns and rows; coarser where there would be too many."""
    side = length / _CELLS_PER_LENGTH
    if area is not None:
        size = (area.right - area.left) * (area.bottom - area.top)
        side = max(side, math.sqrt(size / _MOST_CELLS))
    while True:
        found = [_around(position, reach=length, side=side)]
        found += [] if area is None else [_inside(area, side)]
        index = np.unique(np.concatenate(found), axis=0)
        index = index[image.holds(_middles(index, side))]
        if len(index) <= _MOST_CELLS:
            return side, index
        side *= _COARSER


def _middles(index: NDArray[np.int64], side: float) -> Array:
    return np.asarray((index + 0.5) * side, np.float64)


def _around(position: Array, *, reach: float, side: float) -> NDArray[np.int64]:
    """Number the cells whose middles are in reach of a photo, and those that photos are in."""
    own = np.unique(np.floor(position / side).astype(np.int64), axis=0)
    steps = np.arange(-math.ceil(reach / side), math.ceil(reach / side) + 1)
    columns, rows = np.meshgrid(steps, steps)
    offsets = np.column_stack([columns.ravel(), rows.ravel()])
    offsets = offsets[np.hypot(*offsets.T) * side <= reach]
    return np.unique((own[:, None, :] + offsets[None, :, :]).reshape(-1, 2), axis=0)


def _inside(area: Rectangle, side: float) -> NDArray[np.int64]:
    columns = np.arange(math.floor(area.left / side), math.ceil(area.right / side))
    rows = np.arange(math.floor(area.top / side), math.ceil(area.bottom / side))
    x, y = np.meshgrid(columns, rows)
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)


def _cell_numbers(index: NDArray[np.int64], position: Array, side: float) -> NDArray[np.int64]:
    """Find the number of the cell that each point is in; -1 in none."""
    known = {(int(column), int(row)): number for number, (column, row) in enumerate(index)}
    own = np.floor(position / side).astype(np.int64).tolist()
    return np.array([known.get((column, row), -1) for column, row in own], np.int64)
