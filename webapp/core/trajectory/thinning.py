"""Leaves out poses that hardly differ from the one before.

A robot sends its position up to a hundred times a second, even when it stands still. Only what moved more
than a threshold since the last kept pose is kept, as the search and rescue robot of 2012 did it: by more than
0.00001 degree in latitude or in longitude (1.1 m to the north; to the east 1.1 m at the equator, 0.7 m at 50
degrees). A threshold in metres is the same everywhere.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.trajectory.distance import WGS84
from webapp.errors import UsageError

_WRITTEN = re.compile(r"\s*([0-9]*\.?[0-9]+(?:e-?[0-9]+)?)\s*(m|deg|)\s*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class MinMove:
    """A pose is kept if it is farther than this from the last kept one.

    Attributes
    ----------
    value : float
        Zero keeps every pose, those that have not moved too.
    unit : {"deg", "m"}
        Degrees of latitude or of longitude, whichever changed more; or metres along the geodesic.
    """

    value: float = 0.00001
    unit: Literal["deg", "m"] = "deg"

    def __str__(self) -> str:
        """As `parse_min_move` reads it."""
        return f"{self.value:.12g}{self.unit}" if self.value else "0"


def parse_min_move(text: str) -> MinMove:
    """Read a threshold: `0`, `0.5m`, `0.00001deg`.

    Raises
    ------
    UsageError
        It is none, or has no unit.
    """
    found = _WRITTEN.fullmatch(text)
    value = float(found[1]) if found else math.nan
    if found is None or not math.isfinite(value) or (value and not found[2]):
        hint = "write 0.5m for metres, 0.00001deg for degrees, or 0 to keep every pose"
        raise UsageError(f"{text[:40]!r} is not a distance with a unit", where="min-move", hint=hint)
    return MinMove(value, "m" if found[2].lower() == "m" else "deg")


@dataclass(slots=True)
class Thinner:
    """Thins a track that comes in pieces.

    Attributes
    ----------
    skipped : int
        Poses left out so far.
    """

    min_move: MinMove
    skipped: int = field(default=0, init=False)
    _last: tuple[float, float] | None = field(default=None, init=False)

    def keep(self, latlon: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Choose among the next positions.

        Parameters
        ----------
        latlon : (n, 2) float64
            Degrees north, degrees east; finite.

        Returns
        -------
        (n,) bool
            True for those to keep; the first of a track always is.
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
