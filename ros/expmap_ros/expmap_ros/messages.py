"""Messages that several nodes make."""

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
except ModuleNotFoundError:  # of every distribution, but not among the wheels
    TFMessage = None

TF_MESSAGE: Any = TFMessage
"""Type of `/tf`; None where it is not installed."""

POSES_IN_MAP: type = PosesInMap or String
"""Type of `/poses_in_map`: a text with the same two lists as JSON where `expmap_msgs` is not built."""


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
    """Turn about z, radians."""
    return Quaternion(z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0))


def yaw_of(turn: Quaternion) -> float | None:
    """Angle about z, radians; None for a quaternion of zeros, which some senders put for an unknown turn."""
    if not (turn.x or turn.y or turn.z or turn.w):
        return None
    sin = 2.0 * (turn.w * turn.z + turn.x * turn.y)
    cos = turn.w**2 + turn.x**2 - turn.y**2 - turn.z**2
    return math.atan2(sin, cos)
