"""Level perspective views of equirectangular panoramas, which show the whole sphere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.relative_pose import Camera
from webapp.core.geometry.tilt import LEVEL, Tilt

_DIAGONAL_35MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True, slots=True)
class ViewSize:
    """Size of views of 4:3, whose field of view EXIF can state exactly."""

    width: int
    height: int
    focal_35mm: int  # 35 mm equivalent focal length, by the diagonal, mm

    @property
    def camera(self) -> Camera:
        diagonal = math.hypot(self.width, self.height)
        focal_px = self.focal_35mm / _DIAGONAL_35MM * diagonal
        return Camera(self.width, self.height, math.degrees(2.0 * math.atan(self.width / 2.0 / focal_px)))


def panorama_size(view_width: int, focal_35mm: int) -> tuple[int, int]:
    """Compute the width and height of the panorama that a view was cut from, accurate to two pixels."""
    quarter = view_width / 4.0
    width = 2 * round(math.pi * quarter * 5.0 / _DIAGONAL_35MM * focal_35mm)
    return width, width // 2


def view_size(panorama_width: int, focal_35mm: int) -> ViewSize:
    """Compute the size at which a view has as many pixels per degree in its centre as the panorama.

    Args:
        panorama_width: Pixels of 360 degrees.
    """
    focal_px = panorama_width / (2.0 * math.pi)
    quarter = focal_px / focal_35mm * _DIAGONAL_35MM / 5.0
    return ViewSize(max(4, round(4.0 * quarter)), max(3, round(3.0 * quarter)), focal_35mm)


def view_pixels(
    size: ViewSize, *, panorama: tuple[int, int], turn_deg: float, tilt: Tilt = LEVEL
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Compute the positions in a panorama of all pixels of a level view.

    Args:
        turn_deg: Clockwise rotation of the view from the centre of the panorama.

    Returns:
        x, y: (h, w) float32. Pixels, centres at whole numbers; x may be beyond an edge, where the panorama
            wraps around.
        elevation_deg: (h, w) float32. Above the horizon.
    """
    longest = np.arange(max(size.width, size.height), dtype=np.float64)
    right, down, _ = size.camera.rays(np.stack([longest, longest], 1)).astype(np.float32).T
    right, down = right[: size.width], down[: size.height, None]
    x, y, elevation = _pixels_of_rays(right, down, panorama=panorama, turn_deg=turn_deg, tilt=tilt)
    return np.array(np.broadcast_to(x, y.shape)), y, elevation


def panorama_pixels(
    xy: NDArray[np.float64],
    size: ViewSize,
    *,
    panorama: tuple[int, int],
    turn_deg: float,
    tilt: Tilt = LEVEL,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the positions in a panorama of some pixels of a level view.

    Args:
        xy: (n, 2) float64

    Returns:
        (n, 2) float64: As from `view_pixels`.
        elevation_deg: (n,) float64. Above the horizon.
    """
    right, down, _ = size.camera.rays(xy).T
    x, y, elevation = _pixels_of_rays(right, down, panorama=panorama, turn_deg=turn_deg, tilt=tilt)
    return np.column_stack([x, y]), elevation


def ray_of_panorama(x: float, y: float, tilt: Tilt = LEVEL) -> NDArray[np.float64]:
    """Return the unit vector (3,) to a point of a panorama: level to the right, down, and forward.

    Args:
        x, y: Shares of its width and height, from the top-left corner.
    """
    longitude, elevation = 2.0 * math.pi * (x - 0.5), math.pi * (0.5 - y)
    level = math.cos(elevation)
    own = np.array([level * math.sin(longitude), -math.sin(elevation), level * math.cos(longitude)])
    return own @ tilt.rotation()


def _pixels_of_rays(
    right: NDArray[Any], down: NDArray[Any], *, panorama: tuple[int, int], turn_deg: float, tilt: Tilt
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Project rays of depth 1 to a panorama, in the precision in which they are given."""
    longitude = np.degrees(np.arctan(right)) + turn_deg
    elevation = np.degrees(np.arctan2(-down, np.hypot(right, 1.0)))
    width, height = panorama
    across, up = (
        (longitude, elevation) if tilt.is_level else _tilted(right, down, turn_deg=turn_deg, tilt=tilt)
    )
    x = (across / 360.0 + 0.5) % 1.0 * width - 0.5
    return x, (0.5 - up / 180.0) * height - 0.5, elevation


def _tilted(
    right: NDArray[Any], down: NDArray[Any], *, turn_deg: float, tilt: Tilt
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return longitude and elevation of rays of a level view in the axes of a tilted panorama, degrees."""
    turn = math.radians(turn_deg)
    level = (math.cos(turn) * right + math.sin(turn), down, math.cos(turn) - math.sin(turn) * right)
    x, y, z = (
        sum(float(cell) * part for cell, part in zip(row, level, strict=True)) for row in tilt.rotation()
    )
    return np.degrees(np.arctan2(x, z)), np.degrees(np.arctan2(-y, np.hypot(x, z)))


def cut_view(
    pixels: NDArray[np.uint8], size: ViewSize, *, turn_deg: float, tilt: Tilt = LEVEL
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Cut a level view out of a panorama.

    Args:
        pixels: (H, W) or (H, W, 3) uint8. The whole sphere.

    Returns:
        view: (h, w) or (h, w, 3) uint8
        elevation_deg: (h, w) float32. As from `view_pixels`.
    """
    whole = (pixels.shape[1], pixels.shape[0])
    x, y, elevation = view_pixels(size, panorama=whole, turn_deg=turn_deg, tilt=tilt)
    return sample(pixels, x, y), elevation


def sample(pixels: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Interpolate a panorama at pixels of level views; it wraps around from right to left."""
    return np.asarray(cv2.remap(pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), np.uint8)
