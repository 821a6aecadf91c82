"""What a robot reports in its own frame, on the Earth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros.geodesy import Origin
from expmap_ros.messages import yaw_of


@dataclass(frozen=True, slots=True)
class Sighting:
    """An object that was seen, metres in the frame of its header."""

    header: Header
    id: str
    kind: str
    x: float
    y: float
    confidence: float | None = None


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
        self._frames = ("", "")
        self._at: tuple[float, float, float] | None = None

    def follow(self, odometry: Odometry) -> None:
        """Take note where the robot is, and what its frames are called."""
        at = odometry.pose.pose
        self._frames = (odometry.header.frame_id, odometry.child_frame_id)
        self._at = (at.position.x, at.position.y, yaw_of(at.orientation) or 0.0)

    def pose(self, odometry: Odometry) -> dict[str, Any]:
        """Fields of a pose's record."""
        at = odometry.pose.pose
        lat, lon = self._degrees(at.position.x, at.position.y)
        yaw = yaw_of(at.orientation)
        return {
            "lat": lat,
            "lon": lon,
            "height_m": at.position.z,
            "heading_deg": None if yaw is None else (self._heading_deg - math.degrees(yaw)) % 360.0,
            "covariance": self._covariance(odometry.pose.covariance),
        }

    def place(self, sighting: Sighting) -> tuple[float, float] | None:
        """Degrees of an object; None where its frame is neither that of odometry nor the robot's own."""
        world, body = self._frames
        if sighting.header.frame_id == world:
            return self._degrees(sighting.x, sighting.y)
        if sighting.header.frame_id != body or self._at is None:
            return None
        x, y, yaw = self._at
        forward, left = _turned(sighting.x, sighting.y, yaw)
        return self._degrees(x + forward, y + left)

    def _degrees(self, x: float, y: float) -> tuple[float, float]:
        return self._origin.degrees_of(*_turned(x, y, self._yaw))

    def _covariance(self, matrix: Any) -> list[float] | None:
        """East, north and both, of a 6 x 6 matrix; zeros say that nobody knows."""
        xx, yy, xy = float(matrix[0]), float(matrix[7]), float(matrix[1])
        if xx <= 0 or yy <= 0 or xy * xy > xx * yy or not math.isfinite(xx + yy):
            return None
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        east = c * c * xx - 2 * c * s * xy + s * s * yy
        north = s * s * xx + 2 * c * s * xy + c * c * yy
        return [east, north, c * s * (xx - yy) + (c * c - s * s) * xy]


def sightings_of(message: Any) -> Iterator[Sighting]:
    """Objects with an id of a MarkerArray or a Detection3DArray."""
    if isinstance(message, MarkerArray):
        for marker in message.markers:
            if marker.action == Marker.ADD:
                name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
                at = marker.pose.position
                yield Sighting(marker.header, name, marker.ns or marker.text or "marker", at.x, at.y)
        return
    for detection in message.detections:
        if not detection.id:
            continue
        header = detection.header if detection.header.frame_id else message.header
        best = max((r.hypothesis for r in detection.results), key=lambda h: h.score, default=None)
        at = detection.bbox.center.position
        kind, score = ("object", None) if best is None else (best.class_id or "object", best.score)
        yield Sighting(header, detection.id, kind, at.x, at.y, score)


def _turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    c, s = math.cos(yaw), math.sin(yaw)
    return c * x - s * y, s * x + c * y
