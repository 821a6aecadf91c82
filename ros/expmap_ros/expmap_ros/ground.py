"""Projects pixels of a camera on a robot to the ground, assumed to be level."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Pinhole:
    """Focal lengths and principal point of a rectified image, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, slots=True)
class GroundCamera:
    """A camera on a robot."""

    # `forward`, `left`, `up`: Its position, metres from the robot's position on the ground.
    forward: float
    left: float
    up: float
    # `pitch`, `yaw`: Its viewing direction, radians below the horizon, and to the left.
    pitch: float
    yaw: float

    def on_ground(
        self, column: float, row: float, *, lens: Pinhole, farthest_m: float
    ) -> tuple[float, float] | None:
        """Intersect the ray of a pixel with the ground.

        Returns:
            Metres ahead and to the left of the robot; None if the ray does not meet the ground within
                `farthest_m` of the camera.
        """
        right, down = (column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy
        ahead = math.cos(self.pitch) - down * math.sin(self.pitch)
        falls = math.sin(self.pitch) + down * math.cos(self.pitch)
        if falls <= 0.0:
            return None
        scale = self.up / falls
        x, y = ahead * scale, -right * scale
        if x <= 0.0 or math.hypot(x, y) > farthest_m:
            return None
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.forward + c * x - s * y, self.left + s * x + c * y
