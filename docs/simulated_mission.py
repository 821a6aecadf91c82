"""A round through the park of the sample that no robot ever made, for the screenshots."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon

BEGIN_S = 1_777_629_600.0
"""The first of May 2026, ten in the morning."""

SPEED_MPS = 1.0
EVERY_S = 0.5
GPS_EVERY = 4
GPS_SIGMA_M = 1.2
ASTRAY = {40: (11.0, 7.0), 96: (-9.0, 8.0), 131: (4.0, -13.0)}
"""Errors of some fixes, by number: metres east and north."""

CURVE_RAD_PER_M = 0.004
"""What the odometry does not know of."""


class Round:
    """A drive along given places at a steady speed.

    Args:
        places: In their order; the drive goes straight from one to the next.
    """

    def __init__(self, places: list[LatLon]) -> None:
        self.rng = np.random.default_rng(5)
        self._frame = LocalFrame(places[0])
        corners = self._frame.enu_from_latlon(np.array([tuple(one) for one in places]))
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        at = np.arange(0.0, way[-1], SPEED_MPS * EVERY_S)
        self.truth = np.column_stack([np.interp(at, way, corners[:, axis]) for axis in (0, 1)])
        self.times = BEGIN_S + np.arange(len(at)) * EVERY_S
        self._way = at

    def time_at(self, place: LatLon) -> float:
        """When the robot was nearest to a place, Unix seconds."""
        enu = self._frame.enu_from_latlon(np.array([tuple(place)]))
        return float(self.times[np.argmin(np.hypot(*(self.truth - enu).T))])

    def poses(self) -> list[dict[str, Any]]:
        """Give what odometry and receiver say, as records in the order of time."""
        gps = slice(None, None, GPS_EVERY)
        found = self.truth[gps] + self.rng.normal(0, GPS_SIGMA_M, self.truth[gps].shape)
        for number, off in ASTRAY.items():
            found[number] += off
        spread = [GPS_SIGMA_M**2, GPS_SIGMA_M**2, 0.0]
        records = self._records(self._reckoned(), self.times, source="odometry")
        records += self._records(found, self.times[gps], source="gps", covariance=spread)
        return sorted(records, key=lambda one: float(one["time"]))

    def _reckoned(self) -> NDArray[np.float64]:
        """Where the odometry believes to be: each step is turned a little more than the one before."""
        step = np.diff(self.truth, axis=0)
        turned = CURVE_RAD_PER_M * self._way[1:]
        cos, sin = np.cos(turned), np.sin(turned)
        moved = np.column_stack([cos * step[:, 0] - sin * step[:, 1], sin * step[:, 0] + cos * step[:, 1]])
        return np.vstack([self.truth[:1], self.truth[0] + np.cumsum(moved, axis=0)])

    def _records(
        self, enu: NDArray[np.float64], times: NDArray[np.float64], **more: Any
    ) -> list[dict[str, Any]]:
        latlon = self._frame.latlon_from_enu(enu)
        return [
            {"type": "pose", "time": float(time), "lat": float(lat), "lon": float(lon), **more}
            for time, (lat, lon) in zip(times, latlon, strict=True)
        ]
