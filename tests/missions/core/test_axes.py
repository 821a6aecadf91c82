"""The axes of trajectories, recognised from the motion of a vehicle."""

import numpy as np
import pytest

from webapp.errors import UsageError
from webapp.missions.core.trajectory.axes import Frames, detect_frames, parse_axes, rotations_of, to_robot

ROBOT, CAMERA = Frames("robot", "robot"), Frames("camera", "camera")
CAMERA_FROM_ROBOT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def drive() -> tuple[np.ndarray, np.ndarray]:
    """Return a round trip in a robot's axes: positions, and rotations world from body."""
    yaw = np.linspace(0.0, 4.0, 300)
    steps = np.column_stack([np.cos(yaw), np.sin(yaw), 0.02 * np.ones_like(yaw)])
    zero = np.zeros_like(yaw)
    turns = rotations_of(np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]))
    return np.cumsum(steps, axis=0), turns


def as_camera(xyz: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return xyz @ CAMERA_FROM_ROBOT.T, CAMERA_FROM_ROBOT @ turns @ CAMERA_FROM_ROBOT.T


@pytest.mark.parametrize("usual", [ROBOT, CAMERA])
def test_the_axes_are_those_that_the_motion_shows(usual: Frames) -> None:
    robot, camera = drive(), as_camera(*drive())
    found, remark = detect_frames(*robot, usual=usual)
    assert (found, bool(remark)) == (ROBOT, usual != ROBOT)
    found, remark = detect_frames(*camera, usual=usual)
    assert (found, bool(remark)) == (CAMERA, usual != CAMERA)


def test_a_camera_in_a_world_that_is_level() -> None:
    xyz, turns = drive()
    found, remark = detect_frames(xyz, turns @ CAMERA_FROM_ROBOT.T, usual=ROBOT)
    assert found == Frames("robot", "camera")
    assert "a camera that looks along z" in remark
    local = to_robot(np.zeros(300), xyz, rotation=turns @ CAMERA_FROM_ROBOT.T, frames=found)
    assert np.allclose(local.yaw_rad, np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))
    assert np.array_equal(local.xyz_m, xyz)


def test_a_robot_and_its_camera_come_to_the_same_poses() -> None:
    robot = to_robot(np.zeros(300), drive()[0], rotation=drive()[1], frames=ROBOT)
    camera_xyz, camera_turns = as_camera(*drive())
    camera = to_robot(np.zeros(300), camera_xyz, rotation=camera_turns, frames=CAMERA)
    assert np.allclose(robot.xyz_m, camera.xyz_m)
    assert np.allclose(robot.yaw_rad, camera.yaw_rad)


def test_a_narrow_and_high_track_without_orientations_is_doubtful() -> None:
    xyz = np.column_stack([np.linspace(0, 300, 50), np.linspace(0, 18, 50), np.linspace(0, 497, 50)])
    found, remark = detect_frames(xyz, np.full((50, 3, 3), np.nan), usual=ROBOT)
    assert found == ROBOT
    assert "18 m wide and 497 m high" in remark
    assert detect_frames(xyz[:, [0, 2, 1]], np.full((50, 3, 3), np.nan), usual=ROBOT)[1] == ""


def test_a_body_that_looks_up_has_no_heading() -> None:
    up = np.array([[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
    local = to_robot(np.zeros(1), np.zeros((1, 3)), rotation=up, frames=ROBOT)
    assert np.isnan(local.yaw_rad).all()


def test_other_axes_are_refused() -> None:
    assert parse_axes("") is None
    with pytest.raises(UsageError, match="is not an axis convention"):
        parse_axes("enu")
