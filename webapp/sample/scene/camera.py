"""The pinhole camera that photographs the park, and the poses of its photos."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.plan import ParkPlan

EYE_HEIGHT_M = 1.6

_SWING_DEG, _SWING_STOPS = 28.0, 6.0
_PITCH_DEG = 2.0
_MONUMENT_M = 3.5


@dataclass(frozen=True)
class SceneCamera:
    """A pinhole camera without distortion and without roll."""

    position: tuple[float, float, float]  # East, north, up of the centre of projection, metres
    heading_deg: float  # Direction of the view, degrees clockwise from north
    fov_deg: float  # Horizontal field of view
    # `width`, `height`: Pixels of the photo.
    width: int
    height: int
    # Degrees above the horizon; -90 looks straight down, with `heading_deg` to the top of the photo.
    pitch_deg: float = 0.0

    @cached_property
    def focal_px(self) -> float:
        """Focal length, pixels."""
        return float(self.width / 2 / np.tan(np.radians(self.fov_deg) / 2))

    @cached_property
    def intrinsics(self) -> NDArray[np.float64]:
        """The (3, 3) matrix from camera coordinates to pixels; pixel centres are whole numbers."""
        focal = self.focal_px
        return np.array([[focal, 0, (self.width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]])

    @cached_property
    def camera_from_world(self) -> NDArray[np.float64]:
        """The (3, 3) rotation from east, north, up to right, down, forward."""
        heading, pitch = np.radians(self.heading_deg), np.radians(self.pitch_deg)
        ahead = np.array([np.sin(heading), np.cos(heading), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        right = np.array([np.cos(heading), -np.sin(heading), 0.0])
        forward = np.cos(pitch) * ahead + np.sin(pitch) * up
        return np.stack([right, np.sin(pitch) * ahead - np.cos(pitch) * up, forward])

    def to_camera(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform world points to camera coordinates.

        Args:
            points: (n, 3) float64. East, north, up, metres.

        Returns:
            (n, 3) float64: Right, down, forward, metres.
        """
        return np.asarray((points - np.array(self.position)) @ self.camera_from_world.T, np.float64)

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project world points to pixels.

        Args:
            points: (n, 3) float64. East, north, up, metres.

        Returns:
            pixels: (n, 2) float64. Meaningless where the depth is not positive.
            depth: (n,) float64. Metres along the optical axis.
        """
        local = self.to_camera(points)
        depth = local[:, 2]
        safe = np.where(depth > 0, depth, 1.0)
        centre = np.array([(self.width - 1) / 2, (self.height - 1) / 2])
        return self.focal_px * local[:, :2] / safe[:, None] + centre, depth

    def resized(self, factor: float) -> SceneCamera:
        """Return the same camera with `factor` times the pixels on each side."""
        return SceneCamera(
            self.position,
            self.heading_deg,
            self.fov_deg,
            round(self.width * factor),
            round(self.height * factor),
            self.pitch_deg,
        )


@dataclass(frozen=True, slots=True)
class CameraView:
    """Position and direction of a photo."""

    # `east`, `north`: Metres.
    east: float
    north: float
    heading_deg: float  # Degrees clockwise from north, 0 to 360
    pitch_deg: float  # Degrees above the horizon: a camera in the hand is never quite level

    def camera(self, *, fov_deg: float, width: int, height: int) -> SceneCamera:
        """Return a camera there, at eye height."""
        position = (self.east, self.north, EYE_HEIGHT_M)
        return SceneCamera(position, self.heading_deg, fov_deg, width, height, self.pitch_deg)


def map_views(rng: np.random.Generator, plan: ParkPlan, *, count: int) -> list[CameraView]:
    """Return `count` views, evenly spread over all paths."""
    return [_view(rng, plan, float(stop), stops=count, stray=0.5) for stop in range(count)]


def query_views(rng: np.random.Generator, plan: ParkPlan, *, count: int, stops: int) -> list[CameraView]:
    """Return `count` views between the `stops` of the map, farther from the middle of the paths."""
    between = [int((number + 0.5) * stops / count) + 0.5 for number in range(count)]
    return [_view(rng, plan, stop, stops=stops, stray=1.0) for stop in between]


def _view(rng: np.random.Generator, plan: ParkPlan, stop: float, *, stops: int, stray: float) -> CameraView:
    """Return a view along the path, swinging to both sides; `stray` scales its random deviations."""
    paths = plan.paths
    at = min(max(int((stop + 0.5) / stops * len(paths)), 1), len(paths) - 2)
    line, at = (plan.loop, at) if at < len(plan.loop) else (plan.link, at - len(plan.loop))
    at = min(max(at, 1), len(line) - 2)
    ahead = line[at + 1] - line[at - 1]
    ahead = ahead / np.linalg.norm(ahead)
    aside = float(rng.uniform(-1.4, 1.4)) * stray
    spot = _clear(plan, line[at] + aside * np.array([ahead[1], -ahead[0]]))
    swing = _SWING_DEG * np.sin(2 * np.pi * stop / _SWING_STOPS) + rng.uniform(-12, 12) * stray
    heading = np.degrees(np.arctan2(ahead[0], ahead[1])) + swing
    return CameraView(float(spot[0]), float(spot[1]), float(heading % 360), float(rng.normal(0, _PITCH_DEG)))


def _clear(plan: ParkPlan, spot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move a position away from the monument in the middle of the square."""
    away = spot - plan.square
    distance = float(np.linalg.norm(away))
    if distance >= _MONUMENT_M:
        return spot
    outwards = away / distance if distance > 0 else np.array([1.0, 0.0])
    return np.asarray(plan.square + outwards * _MONUMENT_M, np.float64)
