"""Buildings, trunks and furniture, as textured quadrilaterals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.facades import FLOOR_M, front, window
from webapp.sample.scene.masonry import PIXELS_PER_METRE, Style, roof_surface, surface
from webapp.sample.scene.plan import Footprint
from webapp.sample.scene.raster import Quad, Texture

_UP = np.array([0.0, 0.0, 1.0])
EAVES_M, RISE = 0.45, 0.62
"""Overhang of a roof over the walls, and its slope (rise over run)."""


def lift(point: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    """Return a (2,) point of the ground at a height."""
    return np.array([point[0], point[1], height])


def wall_height(house: Footprint) -> float:
    """Return the height of the eaves, metres."""
    return house.floors * FLOOR_M + 0.35


def ridge_height(house: Footprint) -> float:
    """Return the height of the ridge, metres."""
    return wall_height(house) + RISE * house.depth / 2


def house_quads(rng: np.random.Generator, house: Footprint, *, style: Style) -> list[Quad]:
    """Build a house: four walls, two gables, the roof and a chimney."""
    height = wall_height(house)
    corners = house.corners()
    quads = []
    for number, (left, right) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        along = lift(right - left, 0.0)
        size = (float(np.linalg.norm(along)), height)
        picture = front(rng, size, style=style, entrance=number == 0)
        # corners are counter-clockwise from above: seen from outside, a wall goes from left to right
        quads.append(Quad(lift(left, 0.0), along, _UP * height, Texture.of(picture)))
        if number in (1, 3):
            gable = _gable(rng, size[0], style)
            rise = RISE * size[0] / 2
            quads.append(Quad(lift(left, height), along, _UP * rise, Texture.of(gable)))
    return [*quads, *_roof(rng, house, style), *_chimney(rng, house, style)]


def _gable(rng: np.random.Generator, width: float, style: Style) -> NDArray[np.uint8]:
    shape = (round(RISE * width / 2 * PIXELS_PER_METRE), round(width * PIXELS_PER_METRE))
    wall = surface(rng, shape, material=style.material, colour=style.wall)
    if RISE * width / 2 > style.window_m[1] + 1.2:
        window(rng, wall, foot=(shape[1] // 2, shape[0] + PIXELS_PER_METRE // 2), style=style)
    share = np.abs(np.arange(shape[1]) / shape[1] - 0.5) * 2
    inside = np.arange(shape[0])[:, None] / shape[0] >= share[None, :]
    return np.dstack([wall, np.where(inside, 255, 0).astype(np.uint8)])


def _roof(rng: np.random.Generator, house: Footprint, style: Style) -> list[Quad]:
    """Build two slopes that meet over the middle, with eaves on all sides."""
    reach = house.depth / 2 + EAVES_M
    length = house.width + 2 * EAVES_M
    slope_px = round(reach * np.hypot(1, RISE) * PIXELS_PER_METRE)
    top = ridge_height(house) + 0.05
    quads = []
    for sign in (1.0, -1.0):
        along = lift(house.side * sign * length, 0.0)
        foot = house.centre + house.facing * sign * reach - house.side * sign * length / 2
        up = lift(-house.facing * sign * reach, RISE * reach)
        picture = roof_surface(rng, (slope_px, round(length * PIXELS_PER_METRE)), colour=style.roof)
        quads.append(Quad(lift(foot, top - RISE * reach), along, up, Texture.of(picture), two_sided=True))
    return quads


def _chimney(rng: np.random.Generator, house: Footprint, style: Style) -> list[Quad]:
    at = house.centre + house.side * float(rng.uniform(-0.35, 0.35)) * house.width
    low = ridge_height(house) - 0.9
    bricks = Texture.of(surface(rng, (90, 40), material="brick", colour=(132, 84, 70)))
    return box_quads(lift(at, low), house.side, size=(0.8, 0.8, 1.9), texture=bricks)


def box_quads(
    foot: NDArray[np.float64],
    side: NDArray[np.float64],
    *,
    size: tuple[float, float, float],
    texture: Texture,
) -> list[Quad]:
    """Build a box.

    Args:
        foot: (3,) float64. Centre of its base.
        side: (2,) float64. Unit vector along its width.
        size: Width, depth, height, metres.
        texture: On all sides and on top.
    """
    across = lift(side * size[0] / 2, 0.0)
    out = lift(np.array([side[1], -side[0]]) * size[1] / 2, 0.0)
    up = _UP * size[2]
    corners = [foot - across + out, foot + across + out, foot + across - out, foot - across - out]
    walls = [Quad(corners[i], corners[(i + 1) % 4] - corners[i], up, texture) for i in range(4)]
    return [*walls, Quad(corners[0] + up, across * 2, -out * 2, texture)]
