"""Axis conventions of trajectories (robot, camera, or north-east-down), and their detection in a file.

A robot's axes are x forward, y left, z up (REP 103); a camera's x right, y down, z forward (as in KITTI and
OpenCV); those of autopilots x north or forward, y east or right, z down. A trajectory has two conventions:
one of the world frame of its positions, and one of the body frame of its orientations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from webapp.errors import UsageError
from webapp.missions.core.trajectory.robotframe import LocalPoses

Axes = Literal["robot", "camera", "ned"]
AXES: tuple[Axes, ...] = get_args(Axes)

_ROBOT_FROM: dict[Axes, NDArray[np.float64]] = {
    "robot": np.eye(3),
    "camera": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    "ned": np.diag([1.0, -1.0, -1.0]),
}
_FORWARD: dict[Axes, int] = {"robot": 0, "camera": 2, "ned": 0}
"""Index of the body's forward axis."""

_PLAIN = 0.7
"""Fraction of the path along a body axis above which that is the direction of motion."""

_LEVEL = 0.8
"""Mean cosine between a body axis and the vertical above which the two are taken to coincide."""

_STEEP = 0.5
"""Horizontal component of the forward axis below which the heading is undefined: steeper than 60 degrees."""

_SAMPLES = 500
_HIGH_M = 20.0
_NARROW = 3.0


@dataclass(frozen=True, slots=True)
class Frames:
    """The axis conventions of a trajectory."""

    world: Axes
    body: Axes


def parse_axes(text: str | None) -> Axes | None:
    """Read the name of an axis convention; None for an empty text.

    Raises:
        UsageError: The name is unknown.
    """
    if not text:
        return None
    found = next((axes for axes in AXES if axes == text), None)
    if found is None:
        raise UsageError(
            f"{text[:40]!r} is not an axis convention", where="axes", hint=f"use {', '.join(AXES)}"
        )
    return found


def rotations_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert quaternions (n, 4), x, y, z, w of any length, to matrices (n, 3, 3); NaN for zeros."""
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    x, y, z, w = (quaternion / np.where(length > 0.0, length, math.nan)).T
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def to_robot(
    times_s: NDArray[np.float64],
    xyz_m: NDArray[np.float64],
    *,
    rotation: NDArray[np.float64],
    frames: Frames,
) -> LocalPoses:
    """Convert poses to robot axes; their covariance is unknown.

    Args:
        xyz_m: (n, 3) float64
        rotation: (n, 3, 3) float64. World from body; NaN where unknown. The yaw is NaN where the body looks
            steeply up or down.
    """
    turn = _ROBOT_FROM[frames.world]
    forward = rotation[:, :, _FORWARD[frames.body]] @ turn.T
    level = np.hypot(forward[:, 0], forward[:, 1]) >= _STEEP
    yaw = np.where(level, np.arctan2(forward[:, 1], forward[:, 0]), math.nan)
    return LocalPoses(times_s, xyz_m @ turn.T, yaw, np.full((len(times_s), 3), math.nan))


def detect_frames(
    xyz_m: NDArray[np.float64], rotation: NDArray[np.float64], *, usual: Frames
) -> tuple[Frames, str]:
    """Detect the axis conventions of a trajectory from its motion: a vehicle moves forward and stays upright.

    Args:
        xyz_m: (n, 3) float64
        rotation: (n, 3, 3) float64. World from body; NaN where it is unknown.
        usual: The default, unless the motion clearly contradicts it.

    Returns:
        frames:
        remark: Why the usual axes were not taken, or why they are doubtful; may be empty.
    """
    known = ~np.isnan(rotation).any(axis=(1, 2)) & ~np.isnan(xyz_m).any(axis=1)
    places = np.flatnonzero(known)
    places = places[:: max(1, len(places) // _SAMPLES)]
    found = _of_motion(xyz_m[places], rotation[places], usual) if len(places) > 2 else None
    if found is not None and found != usual:
        return found, _remark(found)
    return usual, "" if found is not None else _doubt(xyz_m, usual)


def _of_motion(xyz_m: NDArray[np.float64], rotation: NDArray[np.float64], usual: Frames) -> Frames | None:
    """Return the axes that the motion indicates; None if it is not conclusive."""
    steps = np.diff(xyz_m, axis=0)
    way = float(np.linalg.norm(steps, axis=1).sum())
    turned = np.abs(rotation - rotation[0]).max() > 0.1
    if way == 0.0 or not turned:
        return None
    ahead = np.einsum("nji,nj->i", rotation[:-1], steps) / way
    upright = rotation.mean(axis=0)
    if ahead[2] > _PLAIN:  # along the optical axis
        if upright[1, 1] > _LEVEL:
            return Frames("camera", "camera")
        return Frames("robot" if upright[2, 1] < -_LEVEL else usual.world, "camera")
    if ahead[0] > _PLAIN and upright[2, 2] > _LEVEL:
        return Frames("ned" if usual.world == "ned" else "robot", "robot")
    return None


def _remark(found: Frames) -> str:
    if found.world == "camera":
        return (
            "the trajectory moves along its z axis and turns about y: it was read as that of a camera, "
            "x right, y down, z forward (set axes=robot if it is not)"
        )
    if found.body == "camera":
        return (
            "the body moves along its z axis: headings are those of a camera that looks along z "
            "(set axes=robot if x is forward)"
        )
    return (
        "the trajectory moves along its x axis and turns about z: it was read as that of a robot, "
        "x forward, y left, z up (set axes=camera if it is not)"
    )


def _doubt(xyz_m: NDArray[np.float64], usual: Frames) -> str:
    """Return a remark on a track that is high and narrow; else an empty text."""
    moved = xyz_m @ _ROBOT_FROM[usual.world].T
    moved = moved[~np.isnan(moved).any(axis=1)]
    if not len(moved):
        return ""
    _, wide, high = np.ptp(moved, axis=0).tolist()
    if high < _HIGH_M or high < _NARROW * wide:
        return ""
    other = "camera" if usual.world == "robot" else "robot"
    return f"the track is {wide:.0f} m wide and {high:.0f} m high: if its axes are others, set axes={other}"
