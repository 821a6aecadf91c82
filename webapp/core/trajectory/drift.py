"""How far a track that comes back to its start misses it: the drift of what recorded it."""

from __future__ import annotations

from dataclasses import dataclass

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon

MOST_SHARE = 0.1
"""Dead reckoning drifts by a few percent of the way; a gap of over a tenth of it is not drift."""

MOST_OF_REACH = 1 / 3
"""The end must be much nearer to the start than the track has been: else it has not come back."""

LEAST_REACH_M = 10.0
"""Within a few metres of its start a receiver that lies on a table walks too, and comes back all the time."""


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """What a closed track misses its start by.

    Attributes
    ----------
    gap_m : float
        From the first position to the last one.
    share : float
        The gap as a part of the distance that was travelled.
    """

    gap_m: float
    share: float


@dataclass(frozen=True, slots=True)
class NoClosure:
    """The track does not close, and why. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Return a drift without a gap."""
        return False


def measure_closure(
    first: LatLon, last: LatLon, *, distance_m: float, bounds: tuple[float, float, float, float]
) -> LoopClosure | NoClosure:
    """Measure by how much a track misses its start, if it returns to it at all.

    A track closes when its end is much nearer to its start than its farthest part is, and the gap is what
    dead reckoning may have drifted by on a way of that length.

    Parameters
    ----------
    first, last : LatLon
        Its ends.
    distance_m : float
        Travelled, all poses counted.
    bounds : (float, float, float, float)
        South, west, north, east of all its positions, degrees.
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
    """Distance from the origin to the farthest side of a box, metres: the track touches each of its sides."""
    south, west, north, east = bounds
    lat, lon = frame.origin
    sides = frame.enu_from_latlon([(south, lon), (north, lon), (lat, west), (lat, east)])
    return float(max((sides**2).sum(axis=1)) ** 0.5)
