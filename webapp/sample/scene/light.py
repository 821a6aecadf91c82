"""Time of day, weather and season."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Light:
    """The conditions a photo is taken in. Colours are linear, 1 is white in full sun."""

    sun_azimuth_deg: float  # Direction of the sun, degrees clockwise from north
    sun_elevation_deg: float  # Above the horizon
    # `sun`, `ambient`: Light of the sun, and of the whole sky.
    sun: Rgb
    ambient: Rgb
    # `zenith`, `horizon`: Colours of the sky overhead and low down (the latter also of haze).
    zenith: Rgb
    horizon: Rgb
    clouds: float  # Share of the sky, 0-1
    noise: float  # Standard deviation of the camera's noise, grey levels of 255
    autumn: bool = False  # Coloured leaves, some of them on the ground

    @property
    def to_sun(self) -> NDArray[np.float64]:
        """The (3,) unit vector towards the sun."""
        azimuth, elevation = np.radians(self.sun_azimuth_deg), np.radians(self.sun_elevation_deg)
        flat = np.cos(elevation)
        return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])


AFTERNOON = Light(
    sun_azimuth_deg=225,
    sun_elevation_deg=48,
    sun=(1.06, 0.98, 0.84),
    ambient=(0.40, 0.44, 0.50),
    zenith=(0.16, 0.34, 0.68),
    horizon=(0.66, 0.76, 0.86),
    clouds=0.45,
    noise=1.2,
)
"""The light of all photos of the sample map."""

EVENING = Light(
    sun_azimuth_deg=280,
    sun_elevation_deg=14,
    sun=(1.30, 0.78, 0.38),
    ambient=(0.32, 0.31, 0.38),
    zenith=(0.22, 0.30, 0.52),
    horizon=(0.86, 0.62, 0.42),
    clouds=0.5,
    noise=2.5,
)
OVERCAST = Light(
    sun_azimuth_deg=180,
    sun_elevation_deg=50,
    sun=(0.05, 0.05, 0.05),
    ambient=(0.68, 0.72, 0.78),
    zenith=(0.55, 0.60, 0.66),
    horizon=(0.72, 0.76, 0.80),
    clouds=1.0,
    noise=1.8,
)
AUTUMN = Light(
    sun_azimuth_deg=200,
    sun_elevation_deg=30,
    sun=(1.10, 0.94, 0.72),
    ambient=(0.38, 0.39, 0.43),
    zenith=(0.24, 0.38, 0.62),
    horizon=(0.74, 0.78, 0.80),
    clouds=0.7,
    noise=1.5,
    autumn=True,
)
