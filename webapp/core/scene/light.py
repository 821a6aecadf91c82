"""Time of day, weather and season."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Light:
    """The conditions a photo is taken in. Colours are linear, 1 is white in full sun.

    Attributes
    ----------
    sun_azimuth_deg : float
        Where the sun stands, degrees clockwise from north.
    sun_elevation_deg : float
        Above the horizon.
    sun, ambient : tuple of float
        Light of the sun, and of the whole sky.
    zenith, horizon : tuple of float
        Colours of the sky overhead and low down (the haze has the latter).
    clouds : float
        Share of the sky, 0-1.
    noise : float
        Standard deviation of the camera's noise, grey levels of 255.
    autumn : bool
        Coloured leaves, some of them on the ground.
    """

    sun_azimuth_deg: float
    sun_elevation_deg: float
    sun: Rgb
    ambient: Rgb
    zenith: Rgb
    horizon: Rgb
    clouds: float
    noise: float
    autumn: bool = False

    @property
    def to_sun(self) -> NDArray[np.float64]:
        """The (3,) unit vector towards the sun."""
        azimuth, elevation = np.radians(self.sun_azimuth_deg), np.radians(self.sun_elevation_deg)
        flat = np.cos(elevation)
        return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])


AFTERNOON = Light(
    225.0, 48.0, (0.92, 0.86, 0.74), (0.34, 0.38, 0.45), (0.16, 0.34, 0.68), (0.66, 0.76, 0.86), 0.45, 1.2
)
"""Of all photos of the sample map."""

EVENING = Light(
    280.0, 14.0, (1.05, 0.62, 0.30), (0.25, 0.25, 0.33), (0.22, 0.30, 0.52), (0.86, 0.62, 0.42), 0.5, 2.5
)
OVERCAST = Light(
    180.0, 50.0, (0.05, 0.05, 0.05), (0.60, 0.64, 0.70), (0.55, 0.60, 0.66), (0.72, 0.76, 0.80), 1.0, 1.8
)
AUTUMN = Light(
    200.0,
    30.0,
    (0.95, 0.80, 0.60),
    (0.32, 0.34, 0.38),
    (0.24, 0.38, 0.62),
    (0.74, 0.78, 0.80),
    0.7,
    1.5,
    True,
)
