"""Fewer points for the same line, for display.

After D. Douglas and T. Peucker, "Algorithms for the reduction of the number of points required to represent a
digitized line or its caricature", The Canadian Cartographer 10 (1973); all parts of a line that are cut at
the same depth are looked at together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_METRES_PER_DEGREE = 111_195.0
"""On a sphere: for display it is the same."""


def simplified(latlon: NDArray[np.float64], tolerance_m: float) -> NDArray[np.bool_]:
    """Choose points of a line so that no other is farther than a tolerance from the line through them.

    Parameters
    ----------
    latlon : (n, 2) float64
        Degrees north, degrees east.

    Returns
    -------
    (n,) bool
        True at the chosen ones: always the first and the last.
    """
    n = len(latlon)
    keep = np.zeros(n, dtype=np.bool_)
    if n == 0:
        return keep
    keep[[0, -1]] = True
    metres = _flat(latlon)
    starts, ends = np.array([0]), np.array([n - 1])
    while True:
        inner = ends - starts > 1
        starts, ends = starts[inner], ends[inner]
        if not len(starts):
            return keep
        far, distance = _farthest(metres, starts, ends)
        cut = distance > tolerance_m
        keep[far[cut]] = True
        starts, ends = (
            np.concatenate([starts[cut], far[cut]]),
            np.concatenate([far[cut], ends[cut]]),
        )


def _flat(latlon: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lay positions on a plane, metres; also where they cross the 180th meridian."""
    lon = np.unwrap(latlon[:, 1], period=360.0)
    across = np.cos(np.radians(latlon[:, 0].mean()))
    return np.column_stack([lon * across, latlon[:, 0]]) * _METRES_PER_DEGREE


def _farthest(
    metres: NDArray[np.float64], starts: NDArray[np.intp], ends: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Find the point farthest from the straight way of each part, and how far it is."""
    counts = ends - starts - 1
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    part = np.repeat(np.arange(len(starts)), counts)
    points = np.arange(counts.sum()) - begins[part] + starts[part] + 1
    origin = metres[starts][part]
    way = (metres[ends] - metres[starts])[part]
    offset = metres[points] - origin
    length2 = (way**2).sum(axis=1)
    along = np.divide((offset * way).sum(axis=1), length2, out=np.zeros(len(way)), where=length2 > 0)
    away = offset - np.clip(along, 0.0, 1.0)[:, None] * way
    distance = np.hypot(away[:, 0], away[:, 1])
    most = np.maximum.reduceat(distance, begins)
    hits = np.flatnonzero(distance == most[part])
    _, first = np.unique(part[hits], return_index=True)
    return points[hits[first]], most
