"""Loop closure error of a track that returns to its start: the drift of its sensor."""

from __future__ import annotations

from dataclasses import dataclass

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon

MOST_SHARE = 0.1
"""Largest gap, as a fraction of the distance, that is drift: dead reckoning drifts by a few percent."""

MOST_OF_REACH = 1 / 3
"""Largest distance between the ends, as a fraction of the track's farthest distance from its start."""

LEAST_REACH_M = 10.0
"""Least such farthest distance: a receiver at rest wanders by a few metres, and returns all the time."""


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """The loop closure error of a track."""

    gap_m: float  # From the first position to the last one
    share: float  # The gap as a fraction of the distance travelled


@dataclass(frozen=True, slots=True)
class NoClosure:
    """The track does not close, and the reason. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Return False: the track does not close."""
        return False


def measure_closure(
    first: LatLon, last: LatLon, *, distance_m: float, bounds: tuple[float, float, float, float]
) -> LoopClosure | NoClosure:
    """Measure the loop closure error of a track, if it returns to its start.

    A track closes if its end is much nearer to its start than its farthest point, and if dead reckoning may
    drift by the gap over the distance travelled.

    Args:
        first, last: Its ends.
        distance_m: Distance travelled, over all poses.
        bounds: South, west, north, east of all its positions, degrees.
    """
    frame = LocalFrame(first)
    east, north, _ = frame.enu_of(last)
    gap = (east * east + north * north) ** 0.5
    reach = _reach(frame, bounds)
    if reach < LEAST_REACH_M:
        return NoClosure(f"it stays within {LEAST_REACH_M:g} m of its start")
    if gap > MOST_OF_REACH * reach:
        return NoClosure(f"it ends {gap:.1f} m from its start, and was never farther than {reach:.1f} m away")
    if gap >= MOST_SHARE * distance_m:
        return NoClosure(f"its ends are {gap:.1f} m apart, more than a tenth of its {distance_m:.1f} m")
    return LoopClosure(gap, gap / distance_m)


def _reach(frame: LocalFrame, bounds: tuple[float, float, float, float]) -> float:
    """Return the distance from the origin to the farthest side of a box, metres: the track touches each."""
    south, west, north, east = bounds
    lat, lon = frame.origin
    sides = frame.enu_from_latlon([(south, lon), (north, lon), (lat, west), (lat, east)])
    return float(max((sides**2).sum(axis=1)) ** 0.5)
