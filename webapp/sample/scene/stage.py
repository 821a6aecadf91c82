"""A park under one light (time of day, weather, season): shadows, sky."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.foliage import Foliage
from webapp.sample.scene.furniture import FENCE_M, fence_corners
from webapp.sample.scene.ground import PAVED, Ground, pixels
from webapp.sample.scene.noise import fractal
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M, Footprint
from webapp.sample.scene.raster import Texture
from webapp.sample.scene.solids import ridge_height, wall_height
from webapp.sample.scene.world import World

SHADOW_METRES_PER_PIXEL = 0.1
_MARGIN_M = 20.0


@dataclass(frozen=True, slots=True)
class Stage:
    """Everything that is needed to render a photo."""

    world: World
    light: Light
    ground: Ground  # In the season of the light
    foliage: Foliage  # In the season of the light
    foliage_sun: NDArray[np.float32]  # (n,) float32. Share of the sun's light on each clump.
    quad_sun: NDArray[np.float64]  # (n,) float64. The same on each quad of the world.
    shadow: NDArray[np.uint8]  # (h, w) uint8. 255 where the sun reaches the ground.
    clouds: NDArray[np.uint8]  # (512, 512) uint8. Tiling; 255 is full cloud cover.


def set_stage(rng: np.random.Generator, world: World, *, light: Light) -> Stage:
    """Set the light of a park; `rng` determines the clouds and the autumn leaves."""
    foliage, ground = world.foliage, world.ground
    if light.autumn:
        foliage, ground = _autumn_leaves(rng, foliage), _fallen_leaves(rng, world)
    to_sun = light.to_sun.astype(np.float32)
    lit = np.clip(0.42 + 0.58 * (foliage.normal @ to_sun), 0.06, 1) * (1 - 0.75 * foliage.depth)
    dim = 1 - 0.5 * foliage.depth - 0.22 * np.clip(-foliage.normal[:, 2], 0, 1)
    foliage = replace(foliage, colour=(foliage.colour * dim[:, None]).astype(np.uint8))
    facing = np.clip(world.normals @ light.to_sun, 0, 1)
    both = ~world.normals.any(axis=1)
    normals = np.stack([quad.normal for quad in world.quads])
    facing[both] = np.abs(normals[both] @ light.to_sun)
    return Stage(
        world=world,
        light=light,
        ground=ground,
        foliage=foliage,
        foliage_sun=lit.astype(np.float32),
        quad_sun=facing,
        shadow=_shadow(world, foliage, light),
        clouds=_clouds(rng, light),
    )


def shadow_pixels(
    east: NDArray[np.float32], north: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Convert metres to pixels of the shadow picture, all (n,)."""
    scale = np.float32(1 / SHADOW_METRES_PER_PIXEL)
    return (east + np.float32(_MARGIN_M)) * scale, (np.float32(DEPTH_M + _MARGIN_M) - north) * scale


def _spots(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Convert (n, 2) metres to whole pixels of the shadow picture."""
    x, y = shadow_pixels(points[:, 0].astype(np.float32), points[:, 1].astype(np.float32))
    return np.stack([x, y], axis=1).astype(np.int32)


def _shadow(world: World, foliage: Foliage, light: Light) -> NDArray[np.uint8]:
    size = (np.array([DEPTH_M, WIDTH_M]) + 2 * _MARGIN_M) / SHADOW_METRES_PER_PIXEL
    dark = np.zeros(size.astype(int), np.uint8)
    to_sun = light.to_sun
    shift = -to_sun[:2] / max(to_sun[2], 0.12)  # metres on the ground for each metre of height
    fall = foliage.centre[:, :2] + foliage.centre[:, 2:] * shift
    for (x, y), radius in zip(_spots(fall.astype(np.float64)), foliage.radius * 0.9, strict=True):
        cv2.circle(dark, (int(x), int(y)), int(radius / SHADOW_METRES_PER_PIXEL), 235, -1)
    for house in world.plan.buildings:
        _house_shadow(dark, house, shift)
    for tree in world.plan.trees:
        if tree.kind not in {"bush", "flowers"}:
            foot = np.array([[tree.east, tree.north]])
            ends = _spots(np.concatenate([foot, foot + shift * tree.height * 0.6]))
            cv2.line(dark, ends[0].tolist(), ends[1].tolist(), 235, max(2, int(tree.height * 0.4)))
    fence = fence_corners() + shift * FENCE_M / 2
    cv2.polylines(dark, [_spots(fence)], True, 110, max(2, int(np.hypot(*shift) * 8)))
    soft = cv2.GaussianBlur(dark, (0, 0), 1.6)
    soft[[0, -1]], soft[:, [0, -1]] = 0, 0  # beyond the picture, everything is lit
    return np.asarray(255 - soft, np.uint8)


def _house_shadow(dark: NDArray[np.uint8], house: Footprint, shift: NDArray[np.float64]) -> None:
    corners = house.corners(margin=0.3)
    ends = (corners[[0, 1]] + corners[[3, 2]]) / 2
    outline = np.concatenate(
        [corners, corners + shift * wall_height(house), ends + shift * ridge_height(house)]
    )
    hull = cv2.convexHull(_spots(outline))
    cv2.fillConvexPoly(dark, hull, 255)


def _clouds(rng: np.random.Generator, light: Light) -> NDArray[np.uint8]:
    noise = fractal(rng, (512, 512), cell_px=190, octaves=6, tiling=True)
    cover = np.clip((noise - (0.55 - 1.1 * light.clouds)) / 0.9, 0, 1)
    return np.asarray(cv2.GaussianBlur((cover * 255).astype(np.uint8), (0, 0), 1.5), np.uint8)


def _autumn_leaves(rng: np.random.Generator, foliage: Foliage) -> Foliage:
    """Remove a third of the leaves, except evergreens', and recolour the others tree by tree."""
    palette = np.array([[198, 128, 40], [176, 84, 36], [206, 164, 62], [140, 112, 50], [112, 124, 54]])
    turned = palette[rng.integers(len(palette), size=int(foliage.plant.max()) + 1)][foliage.plant]
    tone = foliage.colour.mean(axis=1, keepdims=True) / 92
    colour = np.where(foliage.evergreen[:, None], foliage.colour, np.clip(turned * tone, 0, 255))
    kept = foliage.evergreen | (rng.random(foliage.plant.size) > 0.3)
    return replace(foliage, colour=colour.astype(np.uint8)).take(kept)


def _fallen_leaves(rng: np.random.Generator, world: World) -> Ground:
    picture = world.ground.park.texture.levels[0].copy()
    height, width = picture.shape[:2]
    trees = np.array([(t.east, t.north, t.radius) for t in world.plan.trees if t.kind in {"broad", "birch"}])
    under = trees[rng.integers(len(trees), size=70000)]
    at = pixels(under[:, :2] + rng.standard_normal((len(under), 2)) * under[:, 2:] * 0.9)
    at = np.clip(at, 0, (width - 2, height - 2))
    at = at[picture[at[:, 1], at[:, 0], 3] <= PAVED]  # none on the water
    colours = np.array([[196, 130, 46], [170, 92, 40], [204, 170, 80], [128, 92, 52]], np.uint8)
    leaf = colours[rng.integers(len(colours), size=len(at))]
    picture[at[:, 1], at[:, 0], :3] = leaf
    picture[at[:, 1], at[:, 0] + 1, :3] = leaf
    return replace(world.ground, park=replace(world.ground.park, texture=Texture.of(picture)))


Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Light:
    """The conditions a photo is taken in. Colours are linear, 1 is white in full sun."""

    sun_azimuth_deg: float  # Direction of the sun, degrees clockwise from north
    sun_elevation_deg: float  # Above the horizon
    # `sun`, `ambient`: Light of the sun, and of the whole sky.
    sun: Rgb
    ambient: Rgb
    # `zenith`, `horizon`: Colours of the sky overhead and low down (the latter also of haze).
    zenith: Rgb
    horizon: Rgb
    clouds: float  # Share of the sky, 0-1
    noise: float  # Standard deviation of the camera's noise, grey levels of 255
    autumn: bool = False  # Coloured leaves, some of them on the ground

    @property
    def to_sun(self) -> NDArray[np.float64]:
        """The (3,) unit vector towards the sun."""
        azimuth, elevation = np.radians(self.sun_azimuth_deg), np.radians(self.sun_elevation_deg)
        flat = np.cos(elevation)
        return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])


AFTERNOON = Light(
    sun_azimuth_deg=225,
    sun_elevation_deg=48,
    sun=(1.06, 0.98, 0.84),
    ambient=(0.40, 0.44, 0.50),
    zenith=(0.16, 0.34, 0.68),
    horizon=(0.66, 0.76, 0.86),
    clouds=0.45,
    noise=1.2,
)
"""The light of all photos of the sample map."""

EVENING = Light(
    sun_azimuth_deg=280,
    sun_elevation_deg=14,
    sun=(1.30, 0.78, 0.38),
    ambient=(0.32, 0.31, 0.38),
    zenith=(0.22, 0.30, 0.52),
    horizon=(0.86, 0.62, 0.42),
    clouds=0.5,
    noise=2.5,
)
OVERCAST = Light(
    sun_azimuth_deg=180,
    sun_elevation_deg=50,
    sun=(0.05, 0.05, 0.05),
    ambient=(0.68, 0.72, 0.78),
    zenith=(0.55, 0.60, 0.66),
    horizon=(0.72, 0.76, 0.80),
    clouds=1.0,
    noise=1.8,
)
AUTUMN = Light(
    sun_azimuth_deg=200,
    sun_elevation_deg=30,
    sun=(1.10, 0.94, 0.72),
    ambient=(0.38, 0.39, 0.43),
    zenith=(0.24, 0.38, 0.62),
    horizon=(0.74, 0.78, 0.80),
    clouds=0.7,
    noise=1.5,
    autumn=True,
)
