"""A recorded track: positions with times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon


@dataclass(frozen=True, slots=True, eq=False)
class FixTrack:
    """Fixes in the order of time."""

    times_s: NDArray[np.float64]  # (n,) float64. Seconds since 1970, UTC; strictly ascending.
    latlon: NDArray[np.float64]  # (n, 2) float64. Degrees north, degrees east.

    def __len__(self) -> int:
        """Count the fixes."""
        return len(self.times_s)


def make_track(times_s: Sequence[float], positions: Sequence[LatLon]) -> FixTrack:
    """Sort fixes by time; of several with the same time the first is kept.

    Args:
        times_s: Seconds since 1970, UTC.
        positions: One for each time.
    """
    times = np.asarray(times_s, dtype=np.float64).reshape(-1)
    latlon = np.asarray(positions, dtype=np.float64).reshape(-1, 2)
    unique, first = np.unique(times, return_index=True)
    return FixTrack(unique, latlon[first])
