"""What a robot reports in its own frame, on the Earth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros.geodesy import Origin
from expmap_ros.messages import yaw_of


@dataclass(frozen=True, slots=True)
class Sighting:
    """An object that was seen.

    Attributes
    ----------
    id : str
        Empty where it has none.
    x, y : float
        Metres in the frame of the header.
    """

    header: Header
    id: str
    kind: str
    x: float
    y: float
    confidence: float | None = None


@dataclass(frozen=True, slots=True)
class Box:
    """What was detected in an image.

    Attributes
    ----------
    foot : (float, float)
        Column and row of the middle of its lower edge, pixels.
    """

    header: Header
    id: str
    kind: str
    foot: tuple[float, float]
    confidence: float | None


@dataclass(frozen=True, slots=True)
class LocalPose:
    """Where a robot is in a frame of its own.

    Attributes
    ----------
    frame, body : str
        Names of that frame, and of the robot's.
    yaw : float or None
        Radians.
    covariance : sequence of 36 floats, or empty
    """

    frame: str
    body: str
    x: float
    y: float
    z: float
    yaw: float | None
    covariance: Sequence[float] = ()


def pose_of(message: Odometry | TransformStamped) -> LocalPose:
    """Read a pose."""
    frames = (message.header.frame_id, message.child_frame_id)
    if isinstance(message, Odometry):
        at = message.pose.pose
        x, y, z = at.position.x, at.position.y, at.position.z
        return LocalPose(*frames, x, y, z, yaw_of(at.orientation), message.pose.covariance)
    moved, turn = message.transform.translation, message.transform.rotation
    return LocalPose(*frames, moved.x, moved.y, moved.z, yaw_of(turn))


class RobotFrame:
    """The frame of odometry (x forward at the start, y left), laid on the Earth, and the robot in it.

    Parameters
    ----------
    lat, lon, heading : float
        Of its origin, degrees; the heading is that of its x axis, clockwise from north.
    """

    def __init__(self, lat: float, lon: float, heading: float) -> None:
        self._origin = Origin(lat, lon)
        self._heading_deg = heading
        self._yaw = math.radians(90.0 - heading)
        self._newest: LocalPose | None = None

    def follow(self, pose: LocalPose) -> None:
        """Take note where the robot is, and what its frames are called."""
        self._newest = pose

    def fields(self, pose: LocalPose) -> dict[str, Any]:
        """Fields of a pose's record."""
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
        """Whether a pose of the robot has come."""
        return self._newest is not None

    def place(self, sighting: Sighting) -> tuple[float, float] | None:
        """Degrees of an object; None where its frame is neither that of odometry nor the robot's own."""
        robot = self._known_pose()
        if sighting.header.frame_id == robot.frame:
            return self._degrees(sighting.x, sighting.y)
        if sighting.header.frame_id == robot.body:
            return self.ahead(sighting.x, sighting.y)
        return None

    def ahead(self, forward: float, left: float) -> tuple[float, float]:
        """Degrees of a point beside the robot, metres."""
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
        """East, north and both, of a 6 x 6 matrix; zeros say that nobody knows."""
        xx, yy, xy = float(matrix[0]), float(matrix[7]), float(matrix[1])
        if xx <= 0 or yy <= 0 or xy * xy > xx * yy or not math.isfinite(xx + yy):
            return None
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        east = c * c * xx - 2 * c * s * xy + s * s * yy
        north = s * s * xx + 2 * c * s * xy + c * c * yy
        return [east, north, c * s * (xx - yy) + (c * c - s * s) * xy]


def sightings_of(message: Any) -> Iterator[Sighting]:
    """Objects of a MarkerArray or a Detection3DArray."""
    if isinstance(message, MarkerArray):
        for marker in message.markers:
            if marker.action == Marker.ADD:
                name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
                at = marker.pose.position
                yield Sighting(marker.header, name, marker.ns or marker.text or "marker", at.x, at.y)
        return
    for detection in message.detections:
        at = detection.bbox.center.position
        kind, score = _best(detection)
        yield Sighting(_header(detection, message), detection.id, kind, at.x, at.y, score)


def boxes_of(message: Any) -> Iterator[Box]:
    """What a Detection2DArray has."""
    for detection in message.detections:
        at = detection.bbox.center.position
        foot = (at.x, at.y + detection.bbox.size_y / 2.0)
        kind, score = _best(detection)
        yield Box(_header(detection, message), detection.id, kind, foot, score)


def _header(detection: Any, message: Any) -> Header:
    """Header of a detection; what it leaves empty is that of the message."""
    own, whole = detection.header, message.header
    stamped = own if own.stamp.sec or own.stamp.nanosec else whole
    return Header(stamp=stamped.stamp, frame_id=own.frame_id or whole.frame_id)


def _best(detection: Any) -> tuple[str, float | None]:
    """Class and score of the best hypothesis of a detection."""
    best = max((r.hypothesis for r in detection.results), key=lambda h: h.score, default=None)
    return ("object", None) if best is None else (best.class_id or "object", best.score)


def _turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    c, s = math.cos(yaw), math.sin(yaw)
    return c * x - s * y, s * x + c * y
