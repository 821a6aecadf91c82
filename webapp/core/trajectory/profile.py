"""Height, speed and distance of a track in as few points as a diagram can show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COLUMNS = 4
"""time_s, travelled_m, speed_mps, height_m."""


def profile(
    times_s: NDArray[np.float64],
    travelled_m: NDArray[np.float64],
    *,
    height_m: NDArray[np.float64],
    points: int,
) -> NDArray[np.float64]:
    """Choose points of a track: of each part of it the lowest and the highest.

    Parameters
    ----------
    times_s, travelled_m, height_m : (n,) float64
        Heights are NaN where they are not known: there, the ends of a part stand for it.
    points : int
        At most so many.

    Returns
    -------
    (m, 4) float64
        time_s, travelled_m, speed_mps, height_m; the speed is the mean over the part, NaN where its times do
        not grow.
    """
    n = len(times_s)
    if n == 0:
        return np.empty((0, COLUMNS))
    parts = n if n <= points else max(1, points // 2)
    edges = np.linspace(0, n, parts + 1).astype(np.intp)
    begins, ends = edges[:-1], edges[1:]
    before, after = np.maximum(begins - 1, 0), ends - 1
    way, time = travelled_m[after] - travelled_m[before], times_s[after] - times_s[before]
    speed = np.divide(way, time, out=np.full(parts, np.nan), where=time > 0)
    low, high = _extremes(height_m, begins, ends)
    chosen = np.concatenate([np.minimum(low, high), np.maximum(low, high)])
    part = np.tile(np.arange(parts), 2)
    order = np.unique(chosen, return_index=True)[1]
    chosen, part = chosen[order], part[order]
    return np.column_stack([times_s[chosen], travelled_m[chosen], speed[part], height_m[chosen]])


def _extremes(
    height_m: NDArray[np.float64], begins: NDArray[np.intp], ends: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the places of the lowest and the highest of each part; its ends where nothing is known."""
    part = np.repeat(np.arange(len(begins)), ends - begins)
    low, high = begins.copy(), ends - 1
    known = np.flatnonzero(~np.isnan(height_m))
    order = known[np.lexsort((height_m[known], part[known]))]
    heads = np.flatnonzero(np.diff(part[order], prepend=-1))
    tails = np.append(heads[1:], len(order)) - 1
    if len(order):
        low[part[order[heads]]] = order[heads]
        high[part[order[tails]]] = order[tails]
    return low, high
