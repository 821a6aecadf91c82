"""Thinning of tracks: leaves out poses that hardly moved, or that others predict within a tolerance.

A robot sends its position up to a hundred times a second, even at rest. A pose is only kept if it is farther
than a threshold from the last kept one, as on the search and rescue robot of 2012: more than 0.00001 degree
in latitude or longitude (1.1 m to the north; to the east 1.1 m at the equator, 0.7 m at 50 degrees). A
threshold in metres is the same everywhere.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.errors import UsageError
from webapp.missions.core.trajectory.distance import WGS84, metres_per_degree

_METRES_PER_DEGREE = 111_195.0
"""On a sphere, which is accurate enough for display."""

GAP_S = 10.0
GAP_FACTOR = 5.0
"""There is a gap between poses whose interval exceeds this many seconds and this multiple of the median."""

_WRITTEN = re.compile(r"\s*([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)\s*(m|deg|)\s*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class MinMove:
    """A pose is kept if it is farther than this from the last kept one."""

    value: float = 0.00001  # Zero keeps every pose, even without motion
    # Degrees of latitude or of longitude, whichever changed more; or metres along the geodesic.
    unit: Literal["deg", "m"] = "deg"

    def __str__(self) -> str:
        """Write it as `parse_min_move` reads it."""
        return f"{self.value:.12g}{self.unit}" if self.value else "0"


def parse_min_move(text: str) -> MinMove:
    """Read a threshold: `0`, `0.5m`, `0.00001deg`.

    Raises:
        UsageError: It is not a distance, or has no unit.
    """
    found = _WRITTEN.fullmatch(text)
    value = float(found[1]) if found else math.nan
    if found is None or not math.isfinite(value) or (value and not found[2]):
        hint = "write 0.5m for metres, 0.00001deg for degrees, or 0 to keep every pose"
        raise UsageError(f"{text[:40]!r} is not a distance with a unit", where="min-move", hint=hint)
    return MinMove(value, "m" if found[2].lower() == "m" else "deg")


@dataclass(slots=True)
class Thinner:
    """Thins a track that arrives in pieces."""

    min_move: MinMove
    skipped: int = field(default=0, init=False)  # Poses left out so far
    _last: tuple[float, float] | None = field(default=None, init=False)

    def keep(self, latlon: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Choose which of the next positions to keep.

        Args:
            latlon: (n, 2) float64. Degrees north, degrees east; finite.

        Returns:
            (n,) bool: True for those to keep; the first of a track always is.
        """
        if self.min_move.value == 0.0:
            return np.ones(len(latlon), dtype=np.bool_)
        moved = _moved_m if self.min_move.unit == "m" else _moved_deg
        kept = np.zeros(len(latlon), dtype=np.bool_)
        last = self._last
        for i, (lat, lon) in enumerate(latlon.tolist()):
            if last is None or moved(last, lat, lon) > self.min_move.value:
                kept[i], last = True, (lat, lon)
        self._last = last
        self.skipped += len(latlon) - int(np.count_nonzero(kept))
        return kept


def _moved_deg(last: tuple[float, float], lat: float, lon: float) -> float:
    return max(abs(lat - last[0]), abs(math.remainder(lon - last[1], 360.0)))


def _moved_m(last: tuple[float, float], lat: float, lon: float) -> float:
    return float(WGS84.inv(last[1], last[0], lon, lat)[2])


def simplify(latlon: NDArray[np.float64], tolerance_m: float) -> NDArray[np.bool_]:
    """Choose points of a line so that no other is farther than a tolerance from the line through them.

    After D. Douglas and T. Peucker, "Algorithms for the reduction of the number of points required to
    represent a digitized line or its caricature", The Canadian Cartographer 10 (1973); all parts of a line
    that are cut at the same depth are processed together.

    Args:
        latlon: (n, 2) float64. Degrees north, degrees east.

    Returns:
        (n,) bool: True at the chosen ones: always the first and the last.
    """
    return _split_where_far(_ends(len(latlon)), _off_line(_flat(latlon)), tolerance_m)


def simplify_motion(
    times_s: NDArray[np.float64],
    latlon: NDArray[np.float64],
    *,
    height_m: NDArray[np.float64],
    tolerance_m: float,
    gap_s: float | None = None,
) -> NDArray[np.bool_]:
    """Choose poses so that the motion interpolated between them is within a tolerance of all others.

    Interpolation is linear in time: the distance of a pose is that from the interpolated position at its
    time, which preserves stops (N. Meratnia and R. A. de By, "Spatiotemporal compression techniques for
    moving point objects", EDBT 2004). Both poses are chosen around a gap, where time goes backwards, and
    where heights begin or end: nothing is interpolated there.

    Args:
        times_s: (n,) float64
        latlon: (n, 2) float64. Degrees north, degrees east.
        height_m: (n,) float64. NaN where it is not known.
        gap_s: Longest interval that is not a gap; None for that of `GAP_S` and `GAP_FACTOR`.

    Returns:
        (n,) bool: True at the chosen ones: always the first and the last.
    """
    at = np.column_stack([latlon[:, 0], np.unwrap(latlon[:, 1], period=360.0), np.nan_to_num(height_m)])
    waits = np.diff(times_s)
    if gap_s is None:
        gap_s = max(GAP_S, GAP_FACTOR * float(np.median(waits))) if len(waits) else GAP_S
    known = np.isfinite(height_m)
    apart = (waits < 0) | (waits > gap_s) | (known[1:] != known[:-1])
    cuts = np.flatnonzero(apart)
    ends = np.unique(np.concatenate([_ends(len(at)), cuts, cuts + 1]))
    return _split_where_far(ends, _off_motion(times_s, at), tolerance_m)


_Distance = Callable[[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]], NDArray[np.float64]]
"""Distances (n,), metres, of points from the connections of first and last points, all indices (n,)."""


def _split_where_far(ends: NDArray[np.intp], distance: _Distance, tolerance_m: float) -> NDArray[np.bool_]:
    """Choose points of a line: split each part at its farthest point until none is beyond the tolerance.

    Args:
        ends: (m,) intp. Points that are always chosen: ascending, including the first and the last.
    """
    keep = np.zeros(ends[-1] + 1 if len(ends) else 0, dtype=np.bool_)
    keep[ends] = True
    starts, ends = ends[:-1], ends[1:]
    while True:
        inner = ends - starts > 1
        starts, ends = starts[inner], ends[inner]
        if not len(starts):
            return keep
        far, most = _farthest(distance, starts, ends)
        cut = most > tolerance_m
        keep[far[cut]] = True
        starts, ends = (
            np.concatenate([starts[cut], far[cut]]),
            np.concatenate([far[cut], ends[cut]]),
        )


def _ends(n: int) -> NDArray[np.intp]:
    return np.unique(np.array([0, n - 1], dtype=np.intp)) if n else np.empty(0, dtype=np.intp)


def _flat(latlon: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project positions to a plane, metres; also across the 180th meridian."""
    lon = np.unwrap(latlon[:, 1], period=360.0)
    across = np.cos(np.radians(latlon[:, 0].mean())) if len(latlon) else 1.0
    return np.column_stack([lon * across, latlon[:, 0]]) * _METRES_PER_DEGREE


def _farthest(
    distance: _Distance, starts: NDArray[np.intp], ends: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Find the point of each part that is farthest from the connection of its ends, and its distance."""
    counts = ends - starts - 1
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    part = np.repeat(np.arange(len(starts)), counts)
    points = np.arange(counts.sum()) - begins[part] + starts[part] + 1
    away = distance(points, starts[part], ends[part])
    most = np.maximum.reduceat(away, begins)
    hits = np.flatnonzero(away == most[part])
    _, first = np.unique(part[hits], return_index=True)
    return points[hits[first]], most


def _off_line(metres: NDArray[np.float64]) -> _Distance:
    def distance(
        points: NDArray[np.intp], starts: NDArray[np.intp], ends: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        origin = metres[starts]
        way = metres[ends] - origin
        offset = metres[points] - origin
        length2 = (way**2).sum(axis=1)
        along = np.divide((offset * way).sum(axis=1), length2, out=np.zeros(len(way)), where=length2 > 0)
        away = offset - np.clip(along, 0.0, 1.0)[:, None] * way
        return np.asarray(np.hypot(away[:, 0], away[:, 1]))

    return distance


def _off_motion(times_s: NDArray[np.float64], at: NDArray[np.float64]) -> _Distance:
    scale = np.column_stack([*metres_per_degree(at[:, 0]), np.ones(len(at))])

    def distance(
        points: NDArray[np.intp], starts: NDArray[np.intp], ends: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        waited, whole_s = times_s[points] - times_s[starts], times_s[ends] - times_s[starts]
        share = np.divide(waited, whole_s, out=np.zeros(len(points)), where=whole_s > 0)
        expected = at[starts] + share[:, None] * (at[ends] - at[starts])
        return np.asarray(np.linalg.norm((at[points] - expected) * scale[points], axis=1))

    return distance
