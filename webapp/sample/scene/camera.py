"""The pinhole camera that photographs the park."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

EYE_HEIGHT_M = 1.6


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion and without roll.

    Attributes
    ----------
    position : tuple of float
        East, north, up of the centre of projection, metres.
    heading_deg : float
        Direction of the view, degrees clockwise from north.
    fov_deg : float
        Horizontal field of view.
    width, height : int
        Pixels of the photo.
    pitch_deg : float
        Degrees above the horizon; -90 looks straight down, with `heading_deg` to the top of the photo.
    """

    position: tuple[float, float, float]
    heading_deg: float
    fov_deg: float
    width: int
    height: int
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
        """Turn world points into camera coordinates.

        Parameters
        ----------
        points : (n, 3) float64
            East, north, up, metres.

        Returns
        -------
        (n, 3) float64
            Right, down, forward, metres.
        """
        return np.asarray((points - np.array(self.position)) @ self.camera_from_world.T, np.float64)

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Find where world points appear.

        Parameters
        ----------
        points : (n, 3) float64
            East, north, up, metres.

        Returns
        -------
        pixels : (n, 2) float64
            Meaningless where the depth is not positive.
        depth : (n,) float64
            Metres along the optical axis.
        """
        local = self.to_camera(points)
        depth = local[:, 2]
        safe = np.where(depth > 0, depth, 1.0)
        centre = np.array([(self.width - 1) / 2, (self.height - 1) / 2])
        return self.focal_px * local[:, :2] / safe[:, None] + centre, depth

    def resized(self, factor: float) -> Camera:
        """Return the same camera with `factor` times the pixels on each side."""
        return Camera(
            self.position,
            self.heading_deg,
            self.fov_deg,
            round(self.width * factor),
            round(self.height * factor),
            self.pitch_deg,
        )
