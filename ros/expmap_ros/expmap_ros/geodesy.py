"""Metres around an origin on the Earth, by the standard library alone: for the surroundings of a robot.

East and north of the plane that touches the WGS 84 ellipsoid at the origin. Within 5 km, and up to 60 degrees
of latitude, they agree with distances on the ground to a centimetre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_A_M = 6378137.0
_E2 = 6.69437999014e-3
"""Semi-major axis and squared eccentricity of WGS 84."""

_STEPS = 6
"""Each brings the inverse a thousand times nearer, within 5 km."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where x (east) and y (north) are 0, degrees on WGS 84."""

    lat: float
    lon: float

    def metres_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Metres east and north of the origin."""
        radius, height = _from_axis(lat)
        radius0, height0 = _from_axis(self.lat)
        turn, tilt = math.radians(lon - self.lon), math.radians(self.lat)
        outwards = radius * math.cos(turn) - radius0
        return radius * math.sin(turn), math.cos(tilt) * (height - height0) - math.sin(tilt) * outwards

    def degrees_of(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude."""
        lat, lon = self.lat, self.lon
        radius, _ = _from_axis(self.lat)
        for _ in range(_STEPS):
            east, north = self.metres_of(lat, lon)
            lat += math.degrees((y - north) / _A_M)
            lon += math.degrees((x - east) / radius)
        return lat, (lon + 180.0) % 360.0 - 180.0


def _from_axis(lat: float) -> tuple[float, float]:
    """Metres from the Earth's axis, and above the plane of the equator."""
    sin = math.sin(math.radians(lat))
    normal = _A_M / math.sqrt(1.0 - _E2 * sin * sin)
    return normal * math.cos(math.radians(lat)), normal * (1.0 - _E2) * sin
