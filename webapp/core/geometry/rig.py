"""Camera rigs: cameras that share one projection centre, and the panorama stitched from their photos."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.relative_pose import Camera

_BLEND = 8.0
"""Exponent of the distance to a photo's edge in its blending weight: seams are soft, but narrow."""

_ROWS = 64
"""Rows of the panorama computed at a time."""


@dataclass(frozen=True, slots=True)
class RigCamera:
    """How a camera of a rig is mounted."""

    yaw_deg: float  # Clockwise from the rig's front, which is the centre of the panorama
    pitch_deg: float  # Angle of the line of sight above the horizon
    roll_deg: float  # Clockwise, about the line of sight
    fov_deg: float  # Horizontal field of view of the upright photo

    def rotation(self) -> NDArray[np.float64]:
        """Return the rotation from the rig (x right, y down, z front) to the camera."""
        yaw, pitch, roll = np.radians([self.yaw_deg, self.pitch_deg, self.roll_deg])
        forward = np.array(
            [math.cos(pitch) * math.sin(yaw), -math.sin(pitch), math.cos(pitch) * math.cos(yaw)]
        )
        level = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
        upright = np.cross(forward, level)
        right = math.cos(roll) * level + math.sin(roll) * upright
        return np.stack([right, np.cross(forward, right), forward])


@dataclass(frozen=True, slots=True, eq=False)
class RigPhoto:
    """An upright photo, (h, w, 3) uint8, and the camera that took it."""

    pixels: NDArray[np.uint8]
    camera: RigCamera

    @property
    def lens(self) -> Camera:
        height, width = self.pixels.shape[:2]
        return Camera(width, height, self.camera.fov_deg)


def panorama_width(photos: Sequence[RigPhoto]) -> int:
    """Compute the width at which a panorama has as many pixels per degree as the photos in their centres."""
    return 2 * round(math.pi * max(photo.lens.focal_px for photo in photos))


def join(photos: Sequence[RigPhoto], width: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Stitch photos taken from one point at one instant to a panorama of the whole sphere.

    Where photos overlap, the one whose edge is farther away has more weight.

    Args:
        width: Even, pixels; the height is half of it.

    Returns:
        panorama: (width / 2, width, 3) uint8. Equirectangular; black where no camera looks.
        seen: (width / 2, width) bool
    """
    panorama = np.zeros((width // 2, width, 3), np.uint8)
    seen = np.zeros((width // 2, width), np.bool_)
    for top in range(0, width // 2, _ROWS):
        rows = np.arange(top, min(top + _ROWS, width // 2))
        directions = _directions(width, rows)
        total = np.zeros((len(rows), width, 3), np.float32)
        weights = np.zeros((len(rows), width), np.float32)
        for photo in photos:
            weight, sampled = _sample(photo, directions)
            total += weight[..., None] * sampled
            weights += weight
        inside = weights > 0.0
        band = np.zeros_like(total)
        band[inside] = total[inside] / weights[inside, None]
        panorama[rows] = np.rint(band).astype(np.uint8)
        seen[rows] = inside
    return panorama, seen


def _directions(width: int, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Compute the directions (r, width, 3) of the pixels of some rows, in the rig."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    elevation = (0.5 - (rows[:, None] + 0.5) / (width // 2)) * np.pi
    level = np.cos(elevation)
    down = np.broadcast_to(-np.sin(elevation), (len(rows), width))
    return np.stack([level * np.sin(longitude), down, level * np.cos(longitude)], -1)


def _sample(
    photo: RigPhoto, directions: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return weights and colours of a photo in some directions; the weight is 0 outside it."""
    lens = photo.lens
    ray = directions @ photo.camera.rotation().T
    ahead = ray[..., 2] > 1e-6
    depth = np.where(ahead, ray[..., 2], 1.0)
    centre = (lens.width - 1) / 2.0, (lens.height - 1) / 2.0
    x, y = (lens.focal_px * ray[..., axis] / depth + centre[axis] for axis in range(2))
    # beyond the centres of the outermost pixels there are no neighbours for interpolation
    margin = np.minimum(1.0 - np.abs(x / centre[0] - 1.0), 1.0 - np.abs(y / centre[1] - 1.0))
    weight = np.where(ahead & (margin >= 0.0), np.maximum(margin, 1e-3) ** _BLEND, 0.0)
    clipped = (np.clip(axis, -1.0, 32_000.0).astype(np.float32) for axis in (x, y))
    return weight.astype(np.float32), np.asarray(cv2.remap(photo.pixels, *clipped, cv2.INTER_LINEAR))
