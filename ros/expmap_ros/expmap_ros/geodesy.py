"""Local metres around an origin on the Earth, for the surroundings of a robot; standard library only.

East and north in the plane tangent to the WGS 84 ellipsoid at the origin. Within 5 km, and up to 60 degrees
of latitude, they agree with distances on the ground to a centimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_A_M = 6378137.0
_E2 = 6.69437999014e-3
"""Semi-major axis and squared eccentricity of WGS 84."""

_STEPS = 6
"""Iterations of the inverse; within 5 km, each reduces the error a thousandfold."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The point where x (east) and y (north) are 0, degrees on WGS 84."""

    lat: float
    lon: float

    def metres_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Return metres east and north of the origin."""
        radius, height = _from_axis(lat)
        radius0, height0 = _from_axis(self.lat)
        turn, tilt = math.radians(lon - self.lon), math.radians(self.lat)
        outwards = radius * math.cos(turn) - radius0
        return radius * math.sin(turn), math.cos(tilt) * (height - height0) - math.sin(tilt) * outwards

    def degrees_of(self, x: float, y: float) -> tuple[float, float]:
        """Return latitude and longitude of a point in metres."""
        lat, lon = self.lat, self.lon
        radius, _ = _from_axis(self.lat)
        for _ in range(_STEPS):
            east, north = self.metres_of(lat, lon)
            lat += math.degrees((y - north) / _A_M)
            lon += math.degrees((x - east) / radius)
        return lat, (lon + 180.0) % 360.0 - 180.0


def _from_axis(lat: float) -> tuple[float, float]:
    """Return the distances from the Earth's axis and from the equatorial plane, metres."""
    sin = math.sin(math.radians(lat))
    normal = _A_M / math.sqrt(1.0 - _E2 * sin * sin)
    return normal * math.cos(math.radians(lat)), normal * (1.0 - _E2) * sin
