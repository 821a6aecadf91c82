"""Plans the spots where new photos of a map help most, as a short walk.

An added photo recognises others by the model of `recognition`. Its gain is the growth of the recognised share
of the area. It falls as photos are added (submodularity), so that a greedy choice is nearly optimal: at least
63 % of the optimum if any photos may be chosen (G. Nemhauser, L. Wolsey and M. Fisher, "An analysis of
approximations for maximizing submodular set functions", 1978), as for sensors in A. Krause, A. Singh and
C. Guestrin, "Near-optimal sensor placements in Gaussian processes", 2008. In addition, spots are kept apart
here, and photos are taken in several directions at each.

The walk is ordered by nearest neighbours and improved by reversing parts of it (2-opt: G. Croes, "A method
for solving traveling-salesman problems", 1958).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from webapp.core.mapmodel.recognition import (
    DIRECTIONS,
    STEP_DEG,
    Array,
    PhotoTrials,
    RecognitionGrid,
    angle_kernel,
    distance_kernel,
)

Reason = Literal["not-recognised", "one-direction", "direction", "few-photos"]

_MOST_HEADINGS = 4
_WORTH_TURNING = 0.5
"""Least gain of a further photo at a spot, as a fraction of the gain of the first one."""

_APART = math.exp(-0.5)
"""Cells of at least this weight for a chosen spot (within the kernel's length) are no further spots."""

_EPSILON = 1e-9
"""Least saving of length: below it are rounding errors, with which the reversals would never end."""

_MOST_STARTS = 8
"""Largest number of start points of walks to try: with all of many points it would take seconds."""

_LEAST_GAIN = 1e-6
"""Least gain of a spot, as a share of the area."""

_NEAR_DEG = 45.0
_ONE_SIDE_DEG = 120.0
_FAILED = 0.5


@dataclass(frozen=True, slots=True)
class PlannedSpot:
    """A spot where photos should be taken."""

    position: tuple[float, float]  # In the units of the photos
    headings_deg: tuple[float, ...]  # The most useful first; empty if no heading of the map's photos is known
    gain: float  # Expected growth of the recognised share of the area
    # "not-recognised", "one-direction", "direction" or "few-photos". Photos with this heading were not
    # recognised; all photos nearby look to one side; none has this heading; there are few photos nearby, or
    # none.
    reason: Reason
    photos: tuple[int, ...]  # Numbers of the photos that the reason refers to, the nearest first


def plan_spots(grid: RecognitionGrid, photos: PhotoTrials, *, count: int) -> list[PlannedSpot]:
    """Choose spots in the area, in the order of a walk; fewer if no more can be gained."""
    wanted = np.flatnonzero(grid.wanted)
    if not len(wanted) or not len(photos.position):
        return []
    at = distance_kernel(grid.cell[wanted], grid.cell[wanted], length=grid.kernel.length)
    around = grid.kernel.probability * angle_kernel()
    missing, factor = 1.0 - grid.mean[wanted], np.minimum(grid.factor[wanted], 1.0)
    directed = bool(np.isfinite(photos.heading_deg).any())
    free = np.ones(len(wanted), np.bool_)
    chosen: list[PlannedSpot] = []
    while len(chosen) < count and free.any():
        gains = (at @ (factor * missing) @ around).max(axis=1)
        spot = int(np.where(free, gains, -1.0).argmax())
        if gains[spot] < _LEAST_GAIN * missing.size:
            break
        free &= at[spot] < _APART
        headings, gain = _take(missing, factor * at[spot, :, None], around=around, directed=directed)
        place = grid.cell[wanted[spot]]
        reason, about = _reason(place, headings[0] * STEP_DEG, photos, reach=grid.reach)
        x, y = place.tolist()
        towards = tuple(heading * STEP_DEG for heading in headings) if directed else ()
        chosen.append(PlannedSpot((x, y), towards, gain / missing.size, reason, about))
    order = short_walk(np.array([spot.position for spot in chosen]).reshape(-1, 2))
    return [chosen[n] for n in order]


def _take(missing: Array, at: Array, *, around: Array, directed: bool) -> tuple[list[int], float]:
    """Choose photos at a spot and update `missing` in place; return their directions and total gain.

    Args:
        at: (c, DIRECTIONS) float64. Weight of each cell and direction for the spot.
    """
    most, worth = (_MOST_HEADINGS, _WORTH_TURNING) if directed else (DIRECTIONS, 0.0)
    headings: list[int] = []
    total = first = 0.0
    while len(headings) < most:
        gains = (at * missing).sum(axis=0) @ around
        best = int(gains.argmax())
        if best in headings or gains[best] < worth * first:
            break
        first = first or float(gains[best])
        total += float(gains[best])
        headings.append(best)
        missing *= 1.0 - at * around[best]
    return headings, total


def _reason(
    place: Array, heading_deg: float, photos: PhotoTrials, *, reach: float
) -> tuple[Reason, tuple[int, ...]]:
    away = np.hypot(*(photos.position - place).T)
    order = np.argsort(away, kind="stable")
    near = order[away[order] <= reach]
    turned = np.abs((photos.heading_deg - heading_deg + 180.0) % 360.0 - 180.0)
    same = near[~(turned[near] > _NEAR_DEG)]  # including unknown headings
    lost = same[photos.success[same] <= _FAILED]
    if len(lost) and len(lost) > (photos.success[same] > _FAILED).sum():
        return "not-recognised", tuple(lost.tolist())
    if not len(near):
        return "few-photos", ()
    known = near[np.isfinite(photos.heading_deg[near])]
    if not len(known) or (turned[known] <= _NEAR_DEG).any():
        return "few-photos", tuple(near.tolist())
    around = np.sort(photos.heading_deg[known] % 360.0)
    widest = np.diff(np.append(around, around[0] + 360.0)).max()
    reason: Reason = "one-direction" if widest >= 360.0 - _ONE_SIDE_DEG else "direction"
    return reason, tuple(known.tolist())


def short_walk(points: Array) -> list[int]:
    """Order points (n, 2) so that the path from the first to the last is short."""
    if len(points) < 3:
        return list(range(len(points)))
    apart = np.hypot(*(points[:, None, :] - points[None, :, :]).transpose(2, 0, 1))
    starts = np.unique(np.linspace(0, len(points) - 1, _MOST_STARTS).astype(int)).tolist()
    walks = (_without_detours(_nearest_neighbours(apart, start), apart) for start in starts)
    return min(walks, key=lambda walk: walk_length(points[walk]))


def walk_length(points: Array) -> float:
    """Return the length of the path through the points in their order."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _nearest_neighbours(apart: Array, start: int) -> list[int]:
    walk, left = [start], set(range(len(apart))) - {start}
    while left:
        walk.append(min(left, key=lambda point: (apart[walk[-1], point], point)))
        left.remove(walk[-1])
    return walk


def _without_detours(walk: list[int], apart: Array) -> list[int]:
    """Reverse the part of the walk that saves the most, as long as that makes it shorter."""
    order = np.array(walk)
    while True:
        saved = _saved(apart[np.ix_(order, order)])
        first, last = np.unravel_index(saved.argmax(), saved.shape)
        if saved[first, last] <= _EPSILON:
            return [int(point) for point in order]
        order[first : last + 1] = order[first : last + 1][::-1].copy()


def _saved(apart: Array) -> Array:
    """Return by how much a walk gets shorter if the part from a first to a last point is reversed.

    Args:
        apart: (n, n) float64. Distances, in the order of the walk.

    Returns:
        (n, n) float64: By the first and the last one; 0 where the last one is not after the first.
    """
    step = np.diagonal(apart, 1)
    saved = np.zeros_like(apart)
    saved[1:] += step[:, None] - apart[:-1]
    saved[:, :-1] += step - apart[:, 1:]
    return np.triu(saved, 1)
