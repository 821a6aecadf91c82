"""Metres around an origin on the Earth, without any package: for the surroundings of a robot.

A plane that touches the ellipsoid at the origin: within 5 km of it, and 60 degrees of latitude, positions are
right to 2 m, and to 0.1 m within 1 km.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_A_M = 6378137.0
_E2 = 6.69437999014e-3
"""Semi-major axis and squared eccentricity of WGS 84."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where x (east) and y (north) are 0, degrees on WGS 84."""

    lat: float
    lon: float

    def _radii(self) -> tuple[float, float]:
        """Metres a radian to the east and to the north."""
        sin = math.sin(math.radians(self.lat))
        across = _A_M / math.sqrt(1.0 - _E2 * sin * sin)
        along = across * (1.0 - _E2) / (1.0 - _E2 * sin * sin)
        return across * math.cos(math.radians(self.lat)), along

    def metres_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Metres east and north of the origin."""
        east, north = self._radii()
        turn = (lon - self.lon + 180.0) % 360.0 - 180.0
        return math.radians(turn) * east, math.radians(lat - self.lat) * north

    def degrees_of(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude."""
        east, north = self._radii()
        return self.lat + math.degrees(y / north), self.lon + math.degrees(x / east)
