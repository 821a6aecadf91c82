"""How a camera is held in space, with its uncertainty: what a position and a heading leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """The six degrees of freedom of a camera on the map; see also position and heading of the hypothesis.

    Attributes
    ----------
    height_px : float
        Above the camera of the nearest placed photo, map pixels.
    pitch_deg : float
        Of the line of sight above the horizon.
    roll_deg : float
        Clockwise turn of the camera about its line of sight; 0 when its right is level.
    covariance : (6, 6) float64
        Of x, y and height, map pixels, and of heading, pitch and roll, degrees.
    landmarks : int
        Points that agree on it.
    """

    height_px: float
    pitch_deg: float
    roll_deg: float
    covariance: NDArray[np.float64]
    landmarks: int
