"""A robot's own frame <-> the Earth.

The origin is the first pose of the robot: x forward, y left, z up, metres (as in ROS, REP 103). An operator
enters its latitude, longitude and heading. Distances and directions from the start are those of the geodesic,
at any latitude and across the 180th meridian (see `webapp.core.geo.local`).

The robot of 2012 faced east at the start and computed latitude = lat0 + y / b and longitude =
lon0 + x / (a cos lat0). Near the start that is accurate to a percent of the distance, but it is wrong where
the meridians converge: far from the start, and near a pole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.missions.core.trajectory.records import Poses, make_poses


@dataclass(frozen=True, slots=True, eq=False)
class LocalPoses:
    """Poses in a robot's frame, in the order in which they arrived."""

    times_s: NDArray[np.float64]  # (n,) float64. Seconds since 1970, UTC.
    xyz_m: NDArray[np.float64]  # (n, 3) float64. Metres forward, left and up.
    yaw_rad: NDArray[np.float64]  # (n,) float64. From x towards y; NaN where it is unknown.
    # (n, 3) float64. Variance of x, variance of y, covariance of the two; NaN where it is unknown.
    covariance_m2: NDArray[np.float64]

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.times_s)

    def take(self, chosen: slice | NDArray[np.bool_]) -> LocalPoses:
        """Return some of the poses, by a slice or a mask (n,) bool."""
        return LocalPoses(*(getattr(self, one.name)[chosen] for one in fields(self)))


@dataclass(frozen=True, slots=True)
class Start:
    """The start pose of a robot on the Earth."""

    position: LatLon
    heading_deg: float  # Degrees clockwise from north


def parse_start(text: str | None) -> Start | None:
    """Read a start written as `latitude,longitude,heading`; None for an empty text.

    Raises:
        UsageError: It is not valid.
    """
    if not text:
        return None
    hint = "write latitude, longitude and heading: 50.1,14.4,90"
    try:
        lat, lon, heading = map(float, text.split(","))
    except ValueError as error:
        raise UsageError(
            f"{text[:60]!r} is not a start position and heading", where="start", hint=hint
        ) from error
    if not (abs(lat) <= 90 and abs(lon) <= 180 and abs(heading) <= 360):
        raise UsageError(f"{text[:60]!r} is not a valid position or heading", where="start", hint=hint)
    return Start(LatLon(lat, lon), heading)


@dataclass(frozen=True, slots=True)
class Anchor:
    """The first pose in a frame with its origin elsewhere, as in a log that was started on the way."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    yaw_rad: float = 0.0  # From x towards y


@dataclass(frozen=True, slots=True)
class RobotFrame:
    """A robot's frame, georeferenced by its start."""

    start: Start
    anchor: Anchor = field(default_factory=Anchor)  # The pose in the frame that corresponds to the start

    def latlon_from_xy(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert positions to latitude and longitude.

        Args:
            xy_m: (n, 2) float64. Metres forward and left in the frame.

        Returns:
            (n, 2) float64: Degrees north, degrees east.
        """
        offsets = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2) - (self.anchor.x_m, self.anchor.y_m)
        return LocalFrame(self.start.position).latlon_from_enu(offsets @ self._enu_from_xy.T)

    def heading_from_yaw(self, yaw_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert yaws (n,), radians, to headings (n,), 0 <= degrees clockwise from north < 360."""
        degrees: NDArray[np.float64] = np.degrees(yaw_rad - self.anchor.yaw_rad)
        return (self.start.heading_deg - degrees) % 360.0

    def poses(self, local: LocalPoses) -> Poses:
        """Convert poses to the Earth; heights are relative to the start, and `travelled_m` is unknown."""
        return make_poses(
            local.times_s,
            self.latlon_from_xy(local.xyz_m[:, :2]),
            height_m=local.xyz_m[:, 2] - self.anchor.z_m,
            heading_deg=self.heading_from_yaw(local.yaw_rad),
            covariance_m2=self._covariance(local.covariance_m2),
        )

    def _covariance(self, local: NDArray[np.float64]) -> NDArray[np.float64]:
        turn = self._enu_from_xy
        full = local[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
        turned = turn @ full @ turn.T
        return turned.reshape(-1, 4)[:, [0, 3, 1]]

    @property
    def _enu_from_xy(self) -> NDArray[np.float64]:
        """Rotation (2, 2); its columns are the frame's forward and left directions, as east and north."""
        angle = math.radians(self.start.heading_deg) + self.anchor.yaw_rad
        sin, cos = math.sin(angle), math.cos(angle)
        return np.array([[sin, -cos], [cos, sin]])


def anchor_of(local: LocalPoses) -> Anchor:
    """Return the first pose as the anchor; an unknown yaw counts as 0.

    Args:
        local: At least one.
    """
    x, y, z = local.xyz_m[0].tolist()
    yaw = float(local.yaw_rad[0])
    return Anchor(x, y, z, 0.0 if math.isnan(yaw) else yaw)
