"""The transform from the map to the odometry frame, from the robot's poses in both at one time."""

from __future__ import annotations

import math
from bisect import bisect
from dataclasses import dataclass

_KEPT_S = 30.0
"""Length of the history, seconds; older answers are not used."""

_FAR_S = 1.0
"""Poses are not interpolated between transforms farther apart than this, seconds."""


@dataclass(frozen=True, slots=True)
class Planar:
    """A pose on a plane, metres and radians."""

    x: float
    y: float
    yaw: float

    def __matmul__(self, other: Planar) -> Planar:
        """Compose poses: transform `other` from the frame of this pose to its parent frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        x, y = self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y
        return Planar(x, y, math.remainder(self.yaw + other.yaw, math.tau))

    def inverse(self) -> Planar:
        """Return the inverse: the pose of the parent frame in the frame of this pose."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Planar(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)


class PoseHistory:
    """Recent poses of the robot, from odometry."""

    def __init__(self) -> None:
        self._times_s: list[float] = []
        self._poses: list[Planar] = []

    def add(self, time_s: float, pose: Planar) -> None:
        """Add the newest pose; clear the history if the clock goes back."""
        if self._times_s and time_s <= self._times_s[-1]:
            if time_s == self._times_s[-1]:
                return
            self._times_s, self._poses = [], []
        self._times_s.append(time_s)
        self._poses.append(pose)
        if (old := bisect(self._times_s, time_s - _KEPT_S)) > len(self._times_s) // 2:
            del self._times_s[:old], self._poses[:old]

    def at(self, time_s: float) -> Planar | None:
        """Interpolate the pose at a time; return None if it is not between two poses within `_FAR_S`."""
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
    """Return the pose of the odometry frame in the map frame, given the robot's pose in each."""
    return in_map @ in_odometry.inverse()
