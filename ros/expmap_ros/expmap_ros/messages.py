"""Messages that several nodes publish."""

from __future__ import annotations

import json
import math
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from std_msgs.msg import Header, String

from expmap_ros.answers import MapPose

try:
    from expmap_msgs.msg import PosesInMap
except ModuleNotFoundError:  # not built
    PosesInMap = None

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # part of every ROS distribution, but not of the wheels
    TFMessage = None

TF_MESSAGE: Any = TFMessage
"""Type of `/tf`; None if not installed."""

POSES_IN_MAP: type = PosesInMap or String
"""Type of `/poses_in_map`: a String with the same two lists as JSON if `expmap_msgs` is not built."""


def poses_in_map(poses: list[int], probabilities: list[float], *, header: Header) -> Any:
    """Make a message for `/poses_in_map`."""
    if PosesInMap is not None:
        return PosesInMap(header=header, poses=poses, probabilities=probabilities)
    return String(data=json.dumps({"poses": poses, "probabilities": probabilities}))


def pose_message(pose: MapPose, header: Header) -> PoseWithCovarianceStamped:
    """Make a message of a pose."""
    message = PoseWithCovarianceStamped(header=header)
    message.pose.pose.position.x, message.pose.pose.position.y = pose.x, pose.y
    message.pose.pose.orientation = rotation(pose.yaw or 0.0)
    message.pose.covariance = pose.covariance()
    return message


def rotation(yaw: float) -> Quaternion:
    """Return the rotation about z by an angle in radians."""
    return Quaternion(z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0))


def yaw_of(turn: Quaternion) -> float | None:
    """Return the angle about z, radians; None for an all-zero quaternion, which means unknown rotation."""
    if not (turn.x or turn.y or turn.z or turn.w):
        return None
    sin = 2.0 * (turn.w * turn.z + turn.x * turn.y)
    cos = turn.w**2 + turn.x**2 - turn.y**2 - turn.z**2
    return math.atan2(sin, cos)
