"""Leaves out poses that hardly moved; the distance travelled is measured over all poses.

As for imported tracks, a pose is kept if it moved by more than a threshold since the last one kept: in
metres, or in degrees of latitude or longitude, whichever changed more.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from .errors import UsageError

_WRITTEN = re.compile(r"\s*([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)\s*(m|deg|)\s*", re.IGNORECASE)
_A_M = 6_378_137.0
_E2 = 0.00669437999014


@dataclass(frozen=True, slots=True)
class Motion:
    """Sent with each pose kept, and at the end."""

    # Metres since the first pose of the track, measured over all poses, including those left out.
    travelled_m: float
    skipped: int  # Poses left out since the last one kept


class MotionFilter:
    """The filter of one track.

    Args:
        min_move: `0.5m`, `0.00001deg`, or `0`.
        travelled_m: Metres before the first pose, if a track is continued.

    Raises:
        UsageError: `min_move` is not a distance with a unit.
    """

    def __init__(self, min_move: str, *, travelled_m: float = 0.0) -> None:
        self._least, self._in_metres = _parse(min_move)
        self._travelled_m = travelled_m
        self._last: tuple[float, float] | None = None
        self._kept: tuple[float, float] | None = None
        self._skipped = 0

    def update(self, lat: float, lon: float) -> Motion | None:
        """Process the next pose, in degrees; return None if it is left out."""
        here = (lat, lon)
        if self._last is not None:
            self._travelled_m += distance_m(self._last, here)
        self._last = here
        if self._kept is not None and self._least and not self._has_moved(self._kept, here):
            self._skipped += 1
            return None
        motion = Motion(self._travelled_m, self._skipped)
        self._kept, self._skipped = here, 0
        return motion

    def flush(self) -> Motion:
        """Return the motion since the last pose kept, at the end of a track, and reset `skipped`."""
        motion = Motion(self._travelled_m, self._skipped)
        self._skipped = 0
        return motion

    def _has_moved(self, before: tuple[float, float], here: tuple[float, float]) -> bool:
        if self._in_metres:
            return distance_m(before, here) > self._least
        return max(abs(here[0] - before[0]), abs(_wrap_degrees(here[1] - before[1]))) > self._least


def distance_m(before: tuple[float, float], here: tuple[float, float]) -> float:
    """Measure a short distance on WGS 84, from the radii of curvature at its middle latitude.

    Args:
        before, here: Degrees north, degrees east.

    Returns:
        Metres; within a millionth of the geodesic for steps up to a kilometre, away from the poles.
    """
    middle = math.radians((before[0] + here[0]) / 2)
    curved = 1.0 - _E2 * math.sin(middle) ** 2
    north = math.radians(here[0] - before[0]) * _A_M * (1.0 - _E2) / curved**1.5
    east = math.radians(_wrap_degrees(here[1] - before[1])) * _A_M * math.cos(middle) / math.sqrt(curved)
    return math.hypot(north, east)


def _wrap_degrees(degrees: float) -> float:
    return math.remainder(degrees, 360.0)


def _parse(text: str) -> tuple[float, bool]:
    found = _WRITTEN.fullmatch(text)
    value = float(found[1]) if found else math.nan
    if found is None or not math.isfinite(value) or (value and not found[2]):
        hint = "write 0.5m for metres, 0.00001deg for degrees, or 0 to keep every pose"
        raise UsageError(f"{text[:40]!r} is not a distance with a unit", where="min_move", hint=hint)
    return value, found[2].lower() == "m"
