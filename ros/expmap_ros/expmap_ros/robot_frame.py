"""Georeferences poses and objects that a robot reports in its own frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros.geodesy import Origin
from expmap_ros.messages import yaw_of

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
"""Names of the marker types, by number; the same as in imports."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """A detected object."""

    header: Header
    id: str  # Empty if it has none
    kind: str
    # `x`, `y`, `z`: Metres in the frame of the header.
    x: float
    y: float
    z: float
    confidence: float | None = None
    size_m: tuple[float, float, float] | None = None  # Length, width and height


@dataclass(frozen=True, slots=True)
class Box:
    """A detection in an image."""

    header: Header
    id: str
    kind: str
    foot: tuple[float, float]  # Column and row of the middle of its lower edge, pixels
    confidence: float | None
    size_m: None = None  # Unknown for a detection in an image


class Place(NamedTuple):
    """Position of an object: degrees, and metres above the origin of odometry."""

    lat: float
    lon: float
    height_m: float | None


@dataclass(frozen=True, slots=True)
class LocalPose:
    """Pose of a robot in a local frame."""

    # `frame`, `body`: Names of that frame, and of the robot's body frame.
    frame: str
    body: str
    x: float
    y: float
    z: float
    yaw: float | None  # Radians
    covariance: Sequence[float] = ()


def pose_of(message: Odometry | TransformStamped) -> LocalPose:
    """Extract the pose from a message."""
    frames = (message.header.frame_id, message.child_frame_id)
    if isinstance(message, Odometry):
        at = message.pose.pose
        x, y, z = at.position.x, at.position.y, at.position.z
        return LocalPose(*frames, x, y, z, yaw_of(at.orientation), message.pose.covariance)
    moved, turn = message.transform.translation, message.transform.rotation
    return LocalPose(*frames, moved.x, moved.y, moved.z, yaw_of(turn))


class RobotFrame:
    """The georeferenced odometry frame (x forward at the start, y left), and the robot's pose in it.

    Args:
        lat, lon, heading: Of its origin, degrees; the heading is that of its x axis, clockwise from north.
    """

    def __init__(self, lat: float, lon: float, heading: float) -> None:
        self._origin = Origin(lat, lon)
        self._heading_deg = heading
        self._yaw = math.radians(90.0 - heading)
        self._newest: LocalPose | None = None

    def follow(self, pose: LocalPose) -> None:
        """Store the newest pose of the robot, with the names of its frames."""
        self._newest = pose

    def fields(self, pose: LocalPose) -> dict[str, Any]:
        """Return the fields of the record of a pose."""
        lat, lon = self._degrees(pose.x, pose.y)
        heading = None if pose.yaw is None else (self._heading_deg - math.degrees(pose.yaw)) % 360.0
        return {
            "lat": lat,
            "lon": lon,
            "height_m": pose.z,
            "heading_deg": heading,
            "covariance": self._covariance(pose.covariance) if len(pose.covariance) else None,
        }

    @property
    def is_known(self) -> bool:
        """Whether a pose of the robot is known."""
        return self._newest is not None

    def place(self, sighting: Sighting) -> Place | None:
        """Locate an object; return None if its frame is neither that of odometry nor the robot's body."""
        robot = self._known_pose()
        if sighting.header.frame_id == robot.frame:
            return Place(*self._degrees(sighting.x, sighting.y), sighting.z)
        if sighting.header.frame_id == robot.body:
            return Place(*self._ahead(sighting.x, sighting.y), robot.z + sighting.z)
        return None

    def on_ground(self, forward: float, left: float) -> Place:
        """Locate a point relative to the robot, metres; its height is unknown."""
        return Place(*self._ahead(forward, left), None)

    def _ahead(self, forward: float, left: float) -> tuple[float, float]:
        robot = self._known_pose()
        x, y = _turned(forward, left, robot.yaw or 0.0)
        return self._degrees(robot.x + x, robot.y + y)

    def _known_pose(self) -> LocalPose:
        if self._newest is None:
            raise ValueError("no pose of the robot has come")
        return self._newest

    def _degrees(self, x: float, y: float) -> tuple[float, float]:
        return self._origin.degrees_of(*_turned(x, y, self._yaw))

    def _covariance(self, matrix: Sequence[float]) -> list[float] | None:
        """Return [var east, var north, cov] of a 6 x 6 matrix; None if invalid: zeros mean unknown."""
        xx, yy, xy = float(matrix[0]), float(matrix[7]), float(matrix[1])
        if xx <= 0 or yy <= 0 or xy * xy > xx * yy or not math.isfinite(xx + yy):
            return None
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        east = c * c * xx - 2 * c * s * xy + s * s * yy
        north = s * s * xx + 2 * c * s * xy + c * c * yy
        return [east, north, c * s * (xx - yy) + (c * c - s * s) * xy]


def sightings_of(message: Any) -> Iterator[Sighting]:
    """Yield the objects of a MarkerArray or a Detection3DArray."""
    if isinstance(message, MarkerArray):
        for marker in message.markers:
            if marker.action == Marker.ADD:
                name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
                at = marker.pose.position
                yield Sighting(
                    marker.header, name, marker.ns or marker.text or _shape(marker), at.x, at.y, at.z
                )
        return
    for detection in message.detections:
        at = detection.bbox.center.position
        kind, score = _best(detection)
        header, size_m = _header(detection, message), _size(detection)
        yield Sighting(header, detection.id, kind, at.x, at.y, at.z, score, size_m)


def _shape(marker: Marker) -> str:
    return _SHAPES[marker.type] if 0 <= marker.type < len(_SHAPES) else "marker"


def boxes_of(message: Any) -> Iterator[Box]:
    """Yield the detections of a Detection2DArray."""
    for detection in message.detections:
        at = detection.bbox.center.position
        foot = (at.x, at.y + detection.bbox.size_y / 2.0)
        kind, score = _best(detection)
        yield Box(_header(detection, message), detection.id, kind, foot, score)


def _header(detection: Any, message: Any) -> Header:
    """Return the header of a detection; empty fields are taken from the message."""
    own, whole = detection.header, message.header
    stamped = own if own.stamp.sec or own.stamp.nanosec else whole
    return Header(stamp=stamped.stamp, frame_id=own.frame_id or whole.frame_id)


def _best(detection: Any) -> tuple[str, float | None]:
    """Return class and score of the best hypothesis of a detection; a score outside 0 to 1 becomes None."""
    best = max((r.hypothesis for r in detection.results), key=lambda h: h.score, default=None)
    if best is None:
        return "object", None
    return best.class_id or "object", best.score if 0.0 <= best.score <= 1.0 else None


def _size(detection: Any) -> tuple[float, float, float] | None:
    """Return the size of the box of a detection; None if unknown, such as zeros."""
    size = detection.bbox.size
    sides = (size.x, size.y, size.z)
    return sides if all(0.0 < side < math.inf for side in sides) else None


def _turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    c, s = math.cos(yaw), math.sin(yaw)
    return c * x - s * y, s * x + c * y
