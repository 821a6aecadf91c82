"""Where the frame of odometry is in that of the map, by what both say of the robot at one moment."""

from __future__ import annotations

import math
from bisect import bisect
from dataclasses import dataclass

_KEPT_S = 30.0
"""An answer is not older than this."""

_FAR_S = 1.0
"""Between two transforms that are farther apart nobody knows where the robot was."""


@dataclass(frozen=True, slots=True)
class Planar:
    """A pose on a plane, metres and radians."""

    x: float
    y: float
    yaw: float

    def __matmul__(self, other: Planar) -> Planar:
        """Express a pose in this one's frame in that in which this one is."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y
        return Planar(x, y, math.remainder(self.yaw + other.yaw, math.tau))

    def inverse(self) -> Planar:
        """Return the pose of the frame in which this one is, seen from this one."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Planar(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)


class PoseHistory:
    """Where the robot was lately, by odometry."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._poses: list[Planar] = []

    def add(self, time_s: float, pose: Planar) -> None:
        """Take note of the newest pose; a clock that goes back begins anew."""
        if self._times_s and time_s <= self._times_s[-1]:
            if time_s == self._times_s[-1]:
                return
            self._times_s, self._poses = [], []
        self._times_s.append(time_s)
        self._poses.append(pose)
        if (old := bisect(self._times_s, time_s - _KEPT_S)) > len(self._times_s) // 2:
            del self._times_s[:old], self._poses[:old]

    def at(self, time_s: float) -> Planar | None:
        """Interpolate the pose at a time; None where it is not between two that are close."""
        after = bisect(self._times_s, time_s)
        if after and self._times_s[after - 1] == time_s:
            return self._poses[after - 1]
        if not 0 < after < len(self._times_s):
            return None
        start_s, end_s = self._times_s[after - 1 : after + 1]
        if end_s - start_s > _FAR_S:
            return None
        a, b = self._poses[after - 1 : after + 1]
        part = (time_s - start_s) / (end_s - start_s)
        turn = math.remainder(b.yaw - a.yaw, math.tau)
        return Planar(a.x + part * (b.x - a.x), a.y + part * (b.y - a.y), a.yaw + part * turn)


def map_to_odometry(in_map: Planar, in_odometry: Planar) -> Planar:
    """Return where the frame of odometry is in that of the map, if the robot is at both poses."""
    return in_map @ in_odometry.inverse()
