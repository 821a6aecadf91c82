"""Distance travelled, by geodesics on WGS 84 from pose to pose; and the profile of a track.

The distance is measured over all poses, before thinning, which cuts corners. Heights are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Geod

WGS84 = Geod(ellps="WGS84")

COLUMNS = 4
"""time_s, travelled_m, speed_mps, height_m."""


def steps_m(latlon: ArrayLike) -> NDArray[np.float64]:
    """Measure the distance from each position to the next, by Karney's geodesics (J. of Geodesy 87, 2013).

    Args:
        latlon: (n, 2) float64. Degrees north, degrees east.

    Returns:
        (n - 1,) float64: Metres; empty for fewer than two.
    """
    lat, lon = np.asarray(latlon, dtype=np.float64).reshape(-1, 2).T
    return np.asarray(WGS84.inv(lon[:-1], lat[:-1], lon[1:], lat[1:])[2], dtype=np.float64)


def metres_per_degree(lat: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the length of a degree of latitude and of longitude, by the radii of curvature of WGS 84.

    Geodesics would take about ten times as long, and there may be thousands of positions at once.
    """
    a, e2 = WGS84.a, WGS84.es
    root = 1.0 - e2 * np.sin(np.radians(lat)) ** 2
    north = a * (1.0 - e2) / root**1.5
    east = a / np.sqrt(root) * np.cos(np.radians(lat))
    return np.radians(north), np.radians(np.maximum(east, 1.0))


@dataclass(slots=True)
class Odometer:
    """Measures the length of a track that arrives in pieces."""

    metres: float = 0.0  # So far
    _last: NDArray[np.float64] | None = field(default=None, init=False)

    def add(self, latlon: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add the next positions.

        Args:
            latlon: (n, 2) float64. Degrees north, degrees east.

        Returns:
            (n,) float64: Metres along the track from the very first position to each of these.
        """
        if not len(latlon):
            return np.empty(0)
        begin = latlon[:1] if self._last is None else self._last
        travelled = self.metres + np.cumsum(steps_m(np.concatenate([begin, latlon])))
        self._last, self.metres = latlon[-1:], float(travelled[-1])
        return travelled


def fill_travelled(
    latlon: NDArray[np.float64],
    travelled_m: NDArray[np.float64],
    *,
    before: tuple[float, float, float] | None,
) -> NDArray[np.float64]:
    """Fill in missing distances travelled, by the steps since the last pose that has one.

    Args:
        latlon: (n, 2) float64. Degrees north, degrees east.
        travelled_m: (n,) float64. Metres; NaN where unknown.
        before: Degrees north, degrees east and metres travelled of the pose before these; None at the start
            of a track.

    Returns:
        (n,) float64
    """
    if not np.isnan(travelled_m).any():
        return travelled_m
    lat, lon, metres = before or (*latlon[0], 0.0)
    known = np.concatenate([[metres], travelled_m])
    way = np.concatenate([[0.0], np.cumsum(steps_m(np.vstack([[lat, lon], latlon])))])
    last = np.maximum.accumulate(np.where(np.isnan(known), 0, np.arange(len(known))))
    return np.asarray((known[last] + way - way[last])[1:], dtype=np.float64)


def profile(
    times_s: NDArray[np.float64],
    travelled_m: NDArray[np.float64],
    *,
    height_m: NDArray[np.float64],
    points: int,
) -> NDArray[np.float64]:
    """Choose points of a track: the lowest and the highest of each of its parts.

    Args:
        times_s, travelled_m, height_m: (n,) float64. Heights are NaN where unknown: a part without heights is
            represented by its ends.
        points: Largest number of points.

    Returns:
        (m, 4) float64: time_s, travelled_m, speed_mps, height_m; the speed is the mean over the part, NaN
            where time does not increase.
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
    """Find the indices of the lowest and the highest of each part; its ends where no height is known."""
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
