"""The way travelled so far, of poses that do not all tell it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from webapp.core.trajectory.distance import steps_m


def filled(
    latlon: NDArray[np.float64],
    travelled_m: NDArray[np.float64],
    *,
    before: tuple[float, float, float] | None,
) -> NDArray[np.float64]:
    """Give every pose the way travelled: what it tells, or else that of the pose before and the step from it.

    Parameters
    ----------
    latlon : (n, 2) float64
        Degrees north, degrees east.
    travelled_m : (n,) float64
        Metres; NaN where a pose does not tell it.
    before : (float, float, float) or None
        Degrees north, degrees east and metres travelled of the pose before all these; None at the begin of a
        track.

    Returns
    -------
    (n,) float64
    """
    if not np.isnan(travelled_m).any():
        return travelled_m
    lat, lon, metres = before or (*latlon[0], 0.0)
    known = np.concatenate([[metres], travelled_m])
    way = np.concatenate([[0.0], np.cumsum(steps_m(np.vstack([[lat, lon], latlon])))])
    told = np.maximum.accumulate(np.where(np.isnan(known), 0, np.arange(len(known))))
    return np.asarray((known[told] + way - way[told])[1:], dtype=np.float64)
