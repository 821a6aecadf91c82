"""Values of messages, computed from an answer, which is the object of `expmap localize --json`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from expmap_ros.geodesy import Origin

Form = Mapping[str, Any]

AXIS_OF_RADIUS = 1.0 / math.sqrt(-2.0 * math.log(1.0 - 0.68))
"""Standard deviation on each axis of an isotropic normal distribution whose 68 % radius is 1."""

KNOWN_YAW = math.radians(10.0) ** 2
"""Assumed variance of a yaw, square radians: headings in answers are usually right to a few degrees."""

UNKNOWN_YAW = math.pi**2
"""Variance of an unknown yaw, square radians."""


@dataclass(frozen=True, slots=True)
class MapPose:
    """Pose of the camera in the frame of the map."""

    # `x`, `y`: Metres east and north of the origin.
    x: float
    y: float
    yaw: float | None  # Viewing direction of the camera, radians from east towards north
    variance: float  # Of x, and of y, square metres

    def covariance(self) -> list[float]:
        """Return the 36 numbers of a PoseWithCovariance; z, roll and pitch have variance 0."""
        matrix = [0.0] * 36
        matrix[0] = matrix[7] = self.variance
        matrix[35] = KNOWN_YAW if self.yaw is not None else UNKNOWN_YAW
        return matrix


@dataclass(frozen=True, slots=True)
class MapFrame:
    """Converts positions on the map to metres, by an origin on the Earth or by the size of a pixel.

    Without an origin, x and y are measured from the top left corner of the image, to the right and upwards.
    """

    origin: Origin | None
    metres_per_pixel: float | None = None

    def point(self, hypothesis: Form) -> tuple[float, float] | None:
        """Return a position in metres; None if neither is known."""
        if self.origin is not None and hypothesis["lat"] is not None:
            return self.origin.metres_of(hypothesis["lat"], hypothesis["lon"])
        if self.metres_per_pixel is not None:
            return hypothesis["x_px"] * self.metres_per_pixel, -hypothesis["y_px"] * self.metres_per_pixel
        return None

    def radius(self, hypothesis: Form) -> float | None:
        """Return the 68 % radius in metres; None if unknown."""
        if hypothesis["radius_m"] is not None:
            return float(hypothesis["radius_m"])
        if hypothesis["radius_px"] is not None and self.metres_per_pixel is not None:
            return float(hypothesis["radius_px"]) * self.metres_per_pixel
        return None

    def pose(self, hypothesis: Form) -> MapPose | None:
        """Return the pose of a hypothesis; None if its position or accuracy is not known in metres."""
        point, radius = self.point(hypothesis), self.radius(hypothesis)
        if point is None or radius is None:
            return None
        heading = hypothesis["heading_deg"]
        yaw = None if heading is None else math.radians(90.0 - heading)
        return MapPose(*point, yaw, (radius * AXIS_OF_RADIUS) ** 2)


def is_off_map(form: Form) -> bool:
    """Return whether the verdict is that no place of the map leads."""
    return form["verdict"] not in ("place", "perhaps_place")


def poses_in_map(form: Form) -> tuple[list[int], list[float]]:
    """List the best photo and the probability of each place; `[0], [0.0]` if there is none."""
    places = [h for h in form["hypotheses"] if h["experiences"]]
    if not places:
        return [0], [0.0]
    return [h["experiences"][0] for h in places], [h["probability"] for h in places]


def headline(form: Form) -> str:
    """Summarise an answer in one line."""
    if form["verdict"] == "nothing_to_see":
        return "no place: nothing to recognise in the photo"
    if is_off_map(form):
        off = form["off_map_probability"]
        return "not on this map" if off is None else f"not on this map ({off:.0%})"
    best = form["hypotheses"][0]
    photo = f"photo {best['experiences'][0]}" if best["experiences"] else "a place"
    return f"at {best['x_px']:.0f}, {best['y_px']:.0f}, near {photo} ({best['probability']:.0%})"
