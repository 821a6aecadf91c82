"""Extracts poses and objects from messages of the types that are common in ROS 1 and ROS 2.

Message definitions come from the bag itself and can differ: the fields of `vision_msgs` have changed between
versions, so they are looked up by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from webapp.files.exchange.tum import yaw_of
from webapp.missions.files.track_chunks import LocalSighting

_NAN = math.nan
_UNKNOWN = (_NAN, _NAN, _NAN)
_SHAPES = (
    "arrow",
    "cube",
    "sphere",
    "cylinder",
    "line",
    "lines",
    "cubes",
    "spheres",
    "points",
    "text",
    "mesh",
)
_WORLDS = ("map", "odom")
_BODIES = ("base_link", "base_footprint")
_NO_FIX = -1
_ADD = 0


@dataclass(frozen=True, slots=True)
class RosPose:
    """A pose."""

    # Seconds since 1970; latitude, longitude and height, or x, y and z in the robot's frame; yaw, radians;
    # variances of east and north, or of x and y, and their covariance, square metres.
    values: tuple[float, ...]
    frame: str = ""
    body: str = ""
    # The time is from the header of the pose, not that at which the message was recorded.
    stamped: bool = True


@dataclass(frozen=True, slots=True)
class DetectedObject:
    """A detected object, and the name of the frame of its position."""

    frame: str
    sighting: LocalSighting


def _fix(message: Any, at_s: float) -> list[RosPose]:
    if message.status.status <= _NO_FIX:
        return []
    known = message.position_covariance_type != 0
    covariance = _covariance(message.position_covariance, side=3) if known else _UNKNOWN
    place = (message.latitude, message.longitude, message.altitude)
    return [RosPose((_time(message, at_s), *map(float, place), _NAN, *covariance), message.header.frame_id)]


def _odometry(message: Any, at_s: float) -> list[RosPose]:
    covariance = _covariance(message.pose.covariance, side=6)
    values = (_time(message, at_s), *_place(message.pose.pose), *covariance)
    return [RosPose(values, message.header.frame_id, message.child_frame_id)]


def _pose(message: Any, at_s: float) -> list[RosPose]:
    return [RosPose((at_s, *_place(message), *_UNKNOWN), stamped=False)]


def _pose_stamped(message: Any, at_s: float) -> list[RosPose]:
    time_s = _time(message, _NAN)
    stamped = not math.isnan(time_s)
    values = (time_s if stamped else at_s, *_place(message.pose), *_UNKNOWN)
    return [RosPose(values, message.header.frame_id, stamped=stamped)]


def _pose_with_covariance(message: Any, at_s: float) -> list[RosPose]:
    covariance = _covariance(message.pose.covariance, side=6)
    return [RosPose((_time(message, at_s), *_place(message.pose.pose), *covariance), message.header.frame_id)]


def _path(message: Any, at_s: float) -> list[RosPose]:
    rows = [row for pose in message.poses for row in _pose_stamped(pose, at_s)]
    frame = message.header.frame_id
    return [RosPose(row.values, row.frame or frame, stamped=row.stamped) for row in rows]


def _transforms(message: Any, at_s: float) -> list[RosPose]:
    """Read the transforms from a world frame to the robot, found by the usual frame names (REP 105)."""
    rows = []
    for one in message.transforms:
        frame, body = one.header.frame_id, one.child_frame_id
        if frame.rpartition("/")[2] in _WORLDS and body.rpartition("/")[2] in _BODIES:
            place = _point(one.transform.translation, one.transform.rotation)
            rows.append(RosPose((_time(one, at_s), *place, *_UNKNOWN), frame, body))
    return rows


def _detections(message: Any, at_s: float) -> Iterator[DetectedObject]:
    for detection in message.detections:
        frame = detection.header.frame_id or message.header.frame_id
        name = getattr(detection, "id", "") or getattr(detection, "tracking_id", "")
        best = max(detection.results, key=_score, default=None)
        kind = (
            "object" if best is None else str(getattr(_hypothesis(best), "class_id", getattr(best, "id", "")))
        )
        time_s = _time(detection, _time(message, at_s))
        xyz = _xyz(detection.bbox.center.position)
        score = None if best is None else _score(best)
        seen = LocalSighting(str(name) or None, kind or "object", time_s, xyz, score, size_m=_size(detection))
        yield DetectedObject(frame, seen)


def _markers(message: Any, at_s: float) -> Iterator[DetectedObject]:
    for marker in message.markers:
        if marker.action != _ADD:
            continue
        shape = _SHAPES[marker.type] if 0 <= marker.type < len(_SHAPES) else "marker"
        name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
        kind = marker.ns or marker.text or shape
        seen = LocalSighting(name, kind, _time(marker, at_s), _xyz(marker.pose.position))
        yield DetectedObject(marker.header.frame_id, seen)


POSES: dict[str, Callable[[Any, float], list[RosPose]]] = {
    "sensor_msgs/msg/NavSatFix": _fix,
    "nav_msgs/msg/Odometry": _odometry,
    "nav_msgs/msg/Path": _path,
    "geometry_msgs/msg/Pose": _pose,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "tf2_msgs/msg/TFMessage": _transforms,
}
"""Parser of each message type: (message, time of recording in seconds) -> its poses."""

OBJECTS: dict[str, Callable[[Any, float], Iterator[DetectedObject]]] = {
    "vision_msgs/msg/Detection3DArray": _detections,
    "visualization_msgs/msg/MarkerArray": _markers,
}
"""Parser of each message type: (message, time of recording in seconds) -> its objects."""

WORLD = "sensor_msgs/msg/NavSatFix"
"""The type whose poses are on the Earth."""

TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""The type that usually duplicates odometry."""

PLANS = {
    "nav_msgs/msg/Path",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
}
"""The types that also planners send."""

PATH = "nav_msgs/msg/Path"
"""The type whose messages repeat the poses of earlier ones."""


def _time(message: Any, otherwise_s: float) -> float:
    """Return the time in the header; a zero stamp means unknown."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec * 1e-9 if stamp.sec or stamp.nanosec else otherwise_s


def _place(pose: Any) -> tuple[float, float, float, float]:
    return _point(pose.position, pose.orientation)


def _point(at: Any, turn: Any) -> tuple[float, float, float, float]:
    yaw = float(yaw_of(np.array([[turn.x, turn.y, turn.z, turn.w]]))[0])
    return float(at.x), float(at.y), float(at.z), yaw


def _covariance(matrix: Any, *, side: int) -> tuple[float, float, float]:
    """Return the part of the first two axes; non-positive or infinite variances mean unknown."""
    var_x, var_y, cov = float(matrix[0]), float(matrix[side + 1]), float(matrix[1])
    good = 0.0 < var_x < math.inf and 0.0 < var_y < math.inf and cov * cov <= var_x * var_y
    return (var_x, var_y, cov) if good else _UNKNOWN


def _size(detection: Any) -> tuple[float, float, float] | None:
    """Return the size of the bounding box; zeros mean unknown."""
    size = detection.bbox.size
    sides = (float(size.x), float(size.y), float(size.z))
    return sides if all(0.0 < side < math.inf for side in sides) else None


def _xyz(at: Any) -> tuple[float, float, float]:
    return float(at.x), float(at.y), float(at.z)


def _hypothesis(result: Any) -> Any:
    """Return the message with class and score, which is nested since ROS 2 Galactic."""
    return getattr(result, "hypothesis", result)


def _score(result: Any) -> float:
    return float(_hypothesis(result).score)
