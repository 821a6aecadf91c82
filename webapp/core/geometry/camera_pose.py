"""Pose of a camera in space beyond position and heading, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Pose of a camera on the map; position and heading are in the hypothesis."""

    height_px: float  # Height above the camera of the nearest placed photo, map pixels
    pitch_deg: float  # Angle of the line of sight above the horizon
    roll_deg: float  # Clockwise rotation of the camera about its line of sight; 0 if its x axis is level
    # (6, 6) float64. Of x, y and height, map pixels, and of heading, pitch and roll, degrees.
    covariance: NDArray[np.float64]
    landmarks: int  # Number of landmarks that agree on it
