"""How far something has gone: geodesics on WGS 84 from pose to pose.

It is measured on every pose that there is, before any is left out: thinning cuts corners, and would take
standing jitter for a way. Heights play no part.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Geod

WGS84 = Geod(ellps="WGS84")


def steps_m(latlon: ArrayLike) -> NDArray[np.float64]:
    """Measure from each position to the next, by Karney's geodesics (Journal of Geodesy 87, 2013).

    Parameters
    ----------
    latlon : (n, 2) float64
        Degrees north, degrees east.

    Returns
    -------
    (n - 1,) float64
        Metres; empty for fewer than two.
    """
    lat, lon = np.asarray(latlon, dtype=np.float64).reshape(-1, 2).T
    return np.asarray(WGS84.inv(lon[:-1], lat[:-1], lon[1:], lat[1:])[2], dtype=np.float64)


@dataclass(slots=True)
class Odometer:
    """Measures a track that comes in pieces.

    Attributes
    ----------
    metres : float
        So far.
    """

    metres: float = 0.0
    _last: NDArray[np.float64] | None = field(default=None, init=False)

    def add(self, latlon: NDArray[np.float64]) -> NDArray[np.float64]:
        """Go on along the next positions.

        Parameters
        ----------
        latlon : (n, 2) float64
            Degrees north, degrees east.

        Returns
        -------
        (n,) float64
            Metres from the first position of all pieces to each of these, along the track.
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
    """Fill in the distance travelled where a pose lacks it, by the steps since the last pose that has it.

    Parameters
    ----------
    latlon : (n, 2) float64
        Degrees north, degrees east.
    travelled_m : (n,) float64
        Metres; NaN where unknown.
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
    last = np.maximum.accumulate(np.where(np.isnan(known), 0, np.arange(len(known))))
    return np.asarray((known[last] + way - way[last])[1:], dtype=np.float64)
