"""Draws flat textured quadrilaterals into a frame with a depth buffer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.camera import SceneCamera

NEAR_M = 0.2


@dataclass(frozen=True, slots=True)
class Texture:
    """A picture at full, half, quarter ... size (mipmap)."""

    # tuple of (h, w, 4) uint8. Red, green, blue, opacity (drawn where it is above one half).
    levels: tuple[NDArray[np.uint8], ...]

    @staticmethod
    def of(image: NDArray[np.uint8]) -> Texture:
        """Make a texture of a picture, (h, w, 3) or (h, w, 4) uint8."""
        if image.shape[2] == 3:
            image = np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])
        levels = [np.ascontiguousarray(image)]
        while min(levels[-1].shape[:2]) > 3:
            height, width = levels[-1].shape[:2]
            half = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(half, np.uint8))
        return Texture(tuple(levels))


@dataclass(frozen=True)
class Quad:
    """A flat textured parallelogram."""

    corner: NDArray[np.float64]  # (3,) float64. Bottom left of the texture, metres.
    # `along`, `up`: (3,) float64. From there to the bottom right and to the top left, metres.
    along: NDArray[np.float64]
    up: NDArray[np.float64]
    texture: Texture
    two_sided: bool = False  # Also visible from behind (mirrored)

    @cached_property
    def normal(self) -> NDArray[np.float64]:
        """The (3,) unit normal of its visible side."""
        normal = np.cross(self.along, self.up)
        return np.asarray(normal / np.linalg.norm(normal), np.float64)


@dataclass(frozen=True, slots=True)
class Frame:
    """The surface seen at each pixel, before it is lit."""

    colour: NDArray[np.uint32]  # (h, w) uint32. Red, green, blue and one unused byte, in memory order.
    sun: NDArray[np.float32]  # (h, w) float32. Share of the sun's light that arrives, 0-1.
    depth: NDArray[np.float32]  # (h, w) float32. Metres along the optical axis; infinite for the sky.

    @staticmethod
    def empty(camera: SceneCamera) -> Frame:
        shape = (camera.height, camera.width)
        return Frame(
            np.zeros(shape, np.uint32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
        )

    def rgba(self) -> NDArray[np.uint8]:
        """Return the colours as (h, w, 4) uint8; the fourth channel is unused."""
        return self.colour.view(np.uint8).reshape(*self.colour.shape, 4)


@dataclass(frozen=True, slots=True)
class Hits:
    """The pixels at which a quad is the nearest surface so far."""

    index: NDArray[np.int64]  # (n,) int64. Into the flattened frame.
    # `across`, `down`: (n,) float32. Position on the quad, 0-1 from its left and from its top.
    across: NDArray[np.float32]
    down: NDArray[np.float32]
    depth: NDArray[np.float32]  # (n,) float32. Metres.
    # (n,) float32. Texels of the finest level under a pixel, geometric mean of both directions.
    texels: NDArray[np.float32]


def hit_quad(frame: Frame, camera: SceneCamera, *, quad: Quad) -> Hits | None:
    """Find the pixels where a quad is seen; None if there are none."""
    to_camera = np.array(camera.position) - quad.corner
    if not quad.two_sided and to_camera @ quad.normal <= 0:
        return None
    box = _bounding_box(camera, quad)
    if box is None:
        return None
    left, top, right, bottom = box
    rotation = camera.camera_from_world
    axes = np.column_stack([rotation @ quad.along, rotation @ quad.up, -rotation @ to_camera])
    if abs(np.linalg.det(axes)) < 1e-9:
        return None
    quad_from_pixel = np.linalg.inv(camera.intrinsics @ axes)
    x, y = np.arange(left, right, dtype=np.float32), np.arange(top, bottom, dtype=np.float32)[:, None]
    u, v, w = (row[0] * x + (row[1] * y + row[2]) for row in quad_from_pixel.astype(np.float32))
    # homogeneous coordinates: u and v are yet to be divided by w, the inverse depth
    nearer = np.float32(1) / frame.depth[top:bottom, left:right]
    seen = (u >= 0) & (v >= 0) & (u <= w) & (v <= w) & (w > nearer)
    rows, columns = np.nonzero(seen)
    if rows.size == 0:
        return None
    w = w[rows, columns]
    depth = 1 / w
    across, up = u[rows, columns] * depth, v[rows, columns] * depth
    texels = _texels_per_pixel(camera, quad, (columns + left, rows + top, depth))
    index = (rows + top) * camera.width + columns + left
    return Hits(index, across, 1 - up, depth, texels)


def sample(texture: Texture, hits: Hits) -> NDArray[np.uint32]:
    """Look up the texture at each hit, at the level that fits its texels per pixel.

    Returns:
        (n,) uint32: Red, green, blue, opacity, in memory order.
    """
    level = np.clip(np.log2(np.maximum(hits.texels, 1e-6)) + 0.3, 0, len(texture.levels) - 1).astype(np.int8)
    out = np.empty(hits.index.size, np.uint32)
    for number in range(int(level.min()), int(level.max()) + 1):
        chosen = np.nonzero(level == number)[0]
        if chosen.size:
            image = texture.levels[number]
            height, width = image.shape[:2]
            x = hits.across[chosen] * width - 0.5
            y = hits.down[chosen] * height - 0.5
            out[chosen] = look_up(image, x, y)
    return out


def look_up(image: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Interpolate a four-channel picture at (n,) positions; pixel centres are whole numbers."""
    pixels = remap(image, x, y)
    return np.ascontiguousarray(pixels).view(np.uint32).ravel()


def remap(
    image: NDArray[np.uint8],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    *,
    border: int = cv2.BORDER_REPLICATE,
) -> NDArray[np.uint8]:
    """Interpolate a picture at (n,) positions; `border` is OpenCV's mode beyond its edges.

    Returns:
        (n, channels) uint8
    """
    side = 512  # OpenCV wants rows shorter than 2^15
    rows = -(-x.size // side)
    maps = np.zeros((2, rows * side), np.float32)
    maps[0, : x.size], maps[1, : x.size] = x, y
    found = cv2.remap(
        image,
        maps[0].reshape(rows, side),
        maps[1].reshape(rows, side),
        cv2.INTER_LINEAR,
        borderMode=border,
    )
    return np.asarray(found, np.uint8).reshape(rows * side, -1)[: x.size]


def draw_quad(frame: Frame, camera: SceneCamera, *, quad: Quad, sun: float) -> None:
    """Draw a quad where it is nearer than the surface in the frame.

    Args:
        frame: Changed in place.
        sun: Share of the sun's light on it, 0-1.
    """
    hits = hit_quad(frame, camera, quad=quad)
    if hits is None:
        return
    colour = sample(quad.texture, hits)
    there = np.nonzero(colour.view(np.uint8)[3::4] > 127)[0]
    index = hits.index[there]
    frame.colour.reshape(-1)[index] = colour[there]
    frame.depth.reshape(-1)[index] = hits.depth[there]
    frame.sun.reshape(-1)[index] = sun


def _bounding_box(camera: SceneCamera, quad: Quad) -> tuple[int, int, int, int] | None:
    """Return the box of the pixels that can show the quad: left, top, right, bottom (exclusive)."""
    corners = np.stack(
        [quad.corner, quad.corner + quad.along, quad.corner + quad.along + quad.up, quad.corner + quad.up]
    )
    local = camera.to_camera(corners)
    polygon = []
    for here, following in zip(local, local[[1, 2, 3, 0]], strict=True):
        if here[2] >= NEAR_M:
            polygon.append(here)
        if (here[2] >= NEAR_M) != (following[2] >= NEAR_M):  # the edge crosses the near plane
            share = (NEAR_M - here[2]) / (following[2] - here[2])
            polygon.append(here + share * (following - here))
    if not polygon:
        return None
    points = np.stack(polygon)
    pixels = points @ camera.intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    left, top = np.clip(np.floor(pixels.min(0)), 0, (camera.width, camera.height)).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(0)) + 1, 0, (camera.width, camera.height)).astype(int)
    return (left, top, right, bottom) if left < right and top < bottom else None


def _texels_per_pixel(
    camera: SceneCamera, quad: Quad, seen: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]
) -> NDArray[np.float32]:
    columns, rows, depth = seen
    height, width = quad.texture.levels[0].shape[:2]
    per_metre = np.sqrt(width / np.linalg.norm(quad.along) * height / np.linalg.norm(quad.up))
    normal = camera.camera_from_world @ quad.normal
    focal, (cx, cy) = camera.focal_px, camera.intrinsics[:2, 2]
    slant = np.abs(
        (columns - cx).astype(np.float32) * np.float32(normal[0] / focal)
        + (rows - cy).astype(np.float32) * np.float32(normal[1] / focal)
        + np.float32(normal[2])
    )
    texels = depth * np.float32(per_metre / focal) / np.sqrt(np.maximum(slant, 1e-3))
    return np.asarray(texels, np.float32)
