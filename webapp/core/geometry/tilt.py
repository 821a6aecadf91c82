"""The tilt of a panorama whose camera was not level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Tilt:
    """As `PosePitchDegrees` and `PoseRollDegrees` of Photo Sphere state it."""

    pitch_deg: float = 0.0  # Of the middle of the panorama above the horizon; -90 to 90
    # Of the camera, clockwise about its line of sight: the horizon is turned counterclockwise.
    roll_deg: float = 0.0

    @property
    def is_level(self) -> bool:
        return self.pitch_deg == 0.0 and self.roll_deg == 0.0

    def rotation(self) -> NDArray[np.float64]:
        """Return the rotation from level axes, with the same heading, to the panorama's own.

        Returns:
            (3, 3) float64: Both have x to the right, y down, and z towards the middle.
        """
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        forward = np.array([0.0, -math.sin(pitch), math.cos(pitch)])
        down = np.array([0.0, math.cos(pitch), math.sin(pitch)])
        right = np.array([math.cos(roll), 0.0, 0.0]) + math.sin(roll) * down
        return np.stack([right, np.cross(forward, right), forward])


LEVEL = Tilt()
