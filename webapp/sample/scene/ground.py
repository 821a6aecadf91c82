"""The ground of the park: lawn, paths, the paved square, water."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.masonry import courses
from webapp.sample.scene.noise import fractal, tint
from webapp.sample.scene.plan import DEPTH_M, PATH_WIDTH_M, WIDTH_M, ParkPlan
from webapp.sample.scene.raster import Quad, Texture

GRASS, PAVED, WATER = 0, 128, 255
"""Kinds of ground in the fourth channel of a ground texture."""

BORDER_M = 5.0
"""Width of the detailed ground around the park."""

METRES_PER_PIXEL = 0.06
DETAIL_METRES_PER_PIXEL = 0.01


@dataclass(frozen=True, slots=True)
class Ground:
    park: Quad  # The park and `BORDER_M` around it
    country: Quad  # The surroundings, slightly lower and coarse
    # (3, 512, 512) uint8. Tiling brightness (128 for no change), seen from near: grass, gravel, waves.
    detail: NDArray[np.uint8]


def pixels(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Convert (n, 2) metres to whole pixels of the park's texture."""
    x = (points[:, 0] + BORDER_M) / METRES_PER_PIXEL
    y = (DEPTH_M + BORDER_M - points[:, 1]) / METRES_PER_PIXEL
    return np.stack([x, y], axis=1).astype(np.int32)


def lay_ground(rng: np.random.Generator, plan: ParkPlan) -> Ground:
    corner = np.array([-BORDER_M, -BORDER_M, 0.0])
    park = flat(
        corner, (WIDTH_M + 2 * BORDER_M, DEPTH_M + 2 * BORDER_M), texture=Texture.of(_paint(rng, plan))
    )
    far = lawn(rng, (525, 600), metres_per_pixel=0.4)
    country = flat(np.array([-60.0, -60.0, -0.03]), (240.0, 210.0), texture=Texture.of(far))
    return Ground(park, country, _detail(rng))


def flat(corner: NDArray[np.float64], size: tuple[float, float], *, texture: Texture) -> Quad:
    """Lay a texture on level ground, its top to the north."""
    return Quad(corner, np.array([size[0], 0.0, 0.0]), np.array([0.0, size[1], 0.0]), texture)


def lawn(rng: np.random.Generator, shape: tuple[int, int], *, metres_per_pixel: float) -> NDArray[np.uint8]:
    """Paint grass with dry and lush patches, (h, w, 4) uint8."""
    tone = 1 + 0.10 * fractal(rng, shape, cell_px=9 / metres_per_pixel, octaves=7)
    grass = np.dstack([tint((104, 128, 62), tone), np.full(shape, GRASS, np.uint8)])
    dry = np.clip(fractal(rng, shape, cell_px=14 / metres_per_pixel, octaves=5) - 0.25, 0, 0.7)[..., None]
    grass[..., :3] = (grass[..., :3] * (1 - dry) + dry * np.array([150, 140, 84], np.float32)).astype(
        np.uint8
    )
    return grass


def _paint(rng: np.random.Generator, plan: ParkPlan) -> NDArray[np.uint8]:
    shape = (
        round((DEPTH_M + 2 * BORDER_M) / METRES_PER_PIXEL),
        round((WIDTH_M + 2 * BORDER_M) / METRES_PER_PIXEL),
    )
    picture = lawn(rng, shape, metres_per_pixel=METRES_PER_PIXEL)
    _stripes(picture)
    _daisies(rng, picture)
    rough = fractal(rng, shape, cell_px=14, octaves=3)
    _paths(rng, picture, plan, rough=rough)
    _square(rng, picture, plan)
    _pond(picture, plan, rough=rough)
    for house in plan.buildings:
        cv2.fillConvexPoly(picture, pixels(house.corners(margin=0.7)), (132, 128, 120, PAVED), cv2.LINE_AA)
    return picture


def _stripes(picture: NDArray[np.uint8]) -> None:
    """Paint lanes of a mower, each two metres wide."""
    lanes = np.arange(picture.shape[1]) * METRES_PER_PIXEL
    tone = np.where((lanes // 2) % 2 == 0, 1.045, 0.965).astype(np.float32)
    picture[..., :3] = np.clip(picture[..., :3] * tone[None, :, None], 0, 255).astype(np.uint8)


def _daisies(rng: np.random.Generator, picture: NDArray[np.uint8]) -> None:
    """Paint flowers and weeds in patches, which are distinctive of their places."""
    height, width = picture.shape[:2]
    for colour in ((236, 234, 222), (232, 204, 70), (62, 96, 44), (132, 104, 70)):
        spread = fractal(rng, (height // 8, width // 8), cell_px=40, octaves=3)
        spots = rng.integers(0, (height, width), (45000, 2))
        spots = spots[spread[np.minimum(spots[:, 0] // 8, height // 8 - 1), spots[:, 1] // 8 - 1] > 0.35]
        picture[spots[:, 0], spots[:, 1], :3] = colour
        thick = spots[::3]
        picture[np.minimum(thick[:, 0] + 1, height - 1), thick[:, 1], :3] = colour


def _paths(
    rng: np.random.Generator, picture: NDArray[np.uint8], plan: ParkPlan, *, rough: NDArray[np.float32]
) -> None:
    shape = picture.shape[:2]
    mask = np.zeros(shape, np.uint8)
    wide = round(PATH_WIDTH_M / METRES_PER_PIXEL)
    for line, closed in ((plan.loop, True), (plan.link, False)):
        cv2.polylines(mask, [pixels(line)], closed, 255, wide)
    for house in plan.buildings:  # a way from the front door to the path
        door = house.centre + house.facing * house.depth / 2
        target = plan.paths[np.linalg.norm(plan.paths - door, axis=1).argmin()]
        cv2.line(mask, *(tuple(p.tolist()) for p in pixels(np.stack([door, target]))), 255, wide // 2)
    soft = cv2.GaussianBlur(mask, (0, 0), 5).astype(np.float32) / 255 + 0.10 * rough
    gravel = tint((190, 174, 146), 1 + 0.07 * fractal(rng, shape, cell_px=90, octaves=6) + 0.03 * rough)
    stones = rng.integers(0, shape, (60000, 2))
    gravel[stones[:, 0], stones[:, 1]] = rng.integers(70, 225, (60000, 1))
    trodden = (soft > 0.28) & (soft <= 0.5)
    picture[trodden, :3] = (0.72 * picture[trodden, :3] + 0.28 * np.array([118, 98, 68])).astype(np.uint8)
    inside = soft > 0.5
    picture[inside, :3] = gravel[inside]
    picture[inside, 3] = PAVED


def _square(rng: np.random.Generator, picture: NDArray[np.uint8], plan: ParkPlan) -> None:
    reach = plan.square_radius + 2.5
    (left, bottom), (right, top) = pixels(plan.square + np.array([[-reach, -reach], [reach, reach]]))
    part = picture[top:bottom, left:right]
    shape = part.shape[:2]
    tone, joint = courses(rng, shape, size_px=(10.0, 7.0, 1.0), spread=0.1)
    tone[joint] = 0.66
    paving = tint((178, 162, 144), tone)
    flat_colour = np.broadcast_to(np.array([150, 146, 138], np.uint8), paving.shape)
    soil = tint((112, 84, 58), 1 + 0.1 * fractal(rng, shape, cell_px=6))
    y, x = np.mgrid[: shape[0], : shape[1]] * METRES_PER_PIXEL - reach
    away = np.hypot(x, y) - plan.square_radius
    for beyond, surface in ((1.7, soil), (0.25, flat_colour), (0.0, paving)):
        ring = away < beyond
        if beyond > 1:
            ring &= part[..., 3] == GRASS  # the flower bed leaves the path open
        part[ring, :3] = surface[ring]
        part[ring, 3] = PAVED


def _pond(picture: NDArray[np.uint8], plan: ParkPlan, *, rough: NDArray[np.float32]) -> None:
    outline = pixels(plan.pond)
    (left, top), (right, bottom) = outline.min(axis=0) - 50, outline.max(axis=0) + 50
    part, rough = picture[top:bottom, left:right], rough[top:bottom, left:right]
    mask = np.zeros(part.shape[:2], np.uint8)
    cv2.fillPoly(mask, [outline - np.array([left, top], np.int32)], 255)
    near = cv2.GaussianBlur(mask, (0, 0), 12).astype(np.float32) / 255
    shore = near + 0.05 * rough > 0.28
    stone = np.clip(0.95 + 0.25 * rough[shore], 0.5, 1.3)[:, None] * np.array([138, 130, 112])
    part[shore, :3] = np.clip(stone, 0, 255).astype(np.uint8)
    part[shore, 3] = PAVED
    water = near + 0.012 * rough > 0.47
    deep = np.clip((near[water] - 0.4) / 0.5, 0, 1)[:, None]
    part[water, :3] = ((1 - deep) * np.array([92, 106, 84]) + deep * np.array([50, 76, 80])).astype(np.uint8)
    part[water, 3] = WATER


def _detail(rng: np.random.Generator) -> NDArray[np.uint8]:
    shape = (512, 512)
    blades = 128 * (1 + 0.34 * fractal(rng, shape, cell_px=5, octaves=2, tiling=True))
    stones = 128 * (1 + 0.24 * fractal(rng, shape, cell_px=3.5, octaves=2, tiling=True))
    waves = 128 * (1 + 0.16 * fractal(rng, shape, cell_px=60, octaves=4, tiling=True))
    layers = np.stack([blades, stones, waves])
    return np.asarray(np.clip(layers, 0, 255), np.uint8)
