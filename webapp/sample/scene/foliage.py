"""Leaves: clumps at fixed places in the world, drawn as small pictures that face the camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.camera import SceneCamera
from webapp.sample.scene.noise import jitter
from webapp.sample.scene.plan import Tree
from webapp.sample.scene.raster import NEAR_M, Frame

_TONES = np.array([0.62, 0.82, 1.0, 1.2], np.float32)
_SIDES = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
_VARIANTS = 8

Sprite = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
"""Rows and columns (from the centre) and tones of the pixels that are leaf."""

Leaves = tuple[tuple[Sprite, ...], ...]
"""Pictures of clumps: for each size in `_SIDES`, some variants."""


@dataclass(frozen=True, slots=True)
class Foliage:
    centre: NDArray[np.float32]  # (n, 3) float32. Metres.
    radius: NDArray[np.float32]  # (n,) float32. Metres.
    colour: NDArray[np.uint8]  # (n, 3) uint8
    # (n, 3) float32. Outwards from the crown; determines how much light the clump gets.
    normal: NDArray[np.float32]
    depth: NDArray[np.float32]  # (n,) float32. Depth inside its crown: 0 at the surface, 1 in the middle.
    plant: NDArray[np.int32]  # (n,) int32. Number of its tree or bush.
    evergreen: NDArray[np.bool_]  # (n,) bool

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Foliage:
        return Foliage(*(getattr(self, name)[chosen] for name in self.__slots__))


def grow(rng: np.random.Generator, trees: tuple[Tree, ...]) -> Foliage:
    parts = [_crown(rng, tree, number) for number, tree in enumerate(trees)]
    return Foliage(*(np.concatenate([getattr(part, name) for part in parts]) for name in Foliage.__slots__))


def _crown(rng: np.random.Generator, tree: Tree, number: int) -> Foliage:
    count = {"bush": 70, "conifer": 240, "flowers": 24}.get(tree.kind, 230)
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside = np.where(rng.random(count) < 0.18, rng.uniform(0.35, 0.7, count), 0.0)
    lobes = rng.standard_normal((5, 3))
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    bulge = 0.66 + 0.36 * np.clip(direction @ lobes.T, 0, 1).max(axis=1) ** 2 + rng.normal(0, 0.07, count)
    reach = bulge * (1 - inside)
    base = {"bush": 0.0, "flowers": 0.0, "conifer": 0.09, "birch": 0.28}.get(tree.kind, 0.27) * tree.height
    half = (tree.height - base) / 2
    offset = direction * reach[:, None]
    if tree.kind == "conifer":  # a cone: rings that narrow upwards
        up = 1 - np.sqrt(rng.random(count))
        narrow = (1 - up) ** 0.9 * (0.86 + 0.14 * np.sin(up * 38)) * (1 - inside)
        flat = direction[:, :2] / np.maximum(np.linalg.norm(direction[:, :2], axis=1, keepdims=True), 1e-6)
        offset = np.column_stack([flat * narrow[:, None], 2 * up - 1])
        direction = np.column_stack([flat * 0.85, np.full(count, 0.5)])
    slim = 0.72 if tree.kind == "birch" else 1.0
    scale = np.array([tree.radius * slim, tree.radius * slim, half])
    centre = offset * scale + (tree.east, tree.north, base + half)
    size = {"bush": 0.3, "flowers": 0.3, "conifer": 0.2, "birch": 0.19}.get(tree.kind, 0.21) * tree.radius
    palette = {
        "bush": [(84, 116, 52), (104, 122, 60), (70, 104, 66), (150, 92, 96), (170, 150, 80)],
        "conifer": [(44, 74, 48), (52, 80, 64)],
        "flowers": [(196, 60, 66), (226, 176, 60), (150, 84, 156), (226, 220, 214), (74, 112, 54)],
        "birch": [(138, 154, 74), (122, 148, 78)],
    }.get(tree.kind, [(84, 122, 50), (66, 106, 46), (104, 130, 56), (92, 112, 64)])
    main = np.array(jitter(rng, palette[int(rng.integers(len(palette)))], amount=5), np.float64)
    colour = main * rng.normal(1, 0.09, (count, 1)) + rng.normal(0, 4, (count, 3))
    return Foliage(
        centre.astype(np.float32),
        (size * rng.uniform(0.75, 1.3, count)).astype(np.float32),
        np.clip(colour, 0, 255).astype(np.uint8),
        direction.astype(np.float32),
        inside.astype(np.float32),
        np.full(count, number, np.int32),
        np.full(count, tree.kind == "conifer"),
    )


def make_leaf_sprites(rng: np.random.Generator) -> Leaves:
    pictures = [_leaves(rng) for _ in range(_VARIANTS)]
    table = []
    for side in _SIDES:
        variants = []
        for mask, tone in pictures:
            small = cv2.resize(mask, (side, side), interpolation=cv2.INTER_AREA)
            shade = cv2.resize(tone, (side, side), interpolation=cv2.INTER_AREA)
            rows, columns = np.nonzero(np.asarray(small) > 0.42)
            tones = np.clip(np.asarray(shade)[rows, columns] * len(_TONES), 0, len(_TONES) - 1)
            half = side // 2
            variants.append(
                ((rows - half).astype(np.int32), (columns - half).astype(np.int32), tones.astype(np.int32))
            )
        table.append(tuple(variants))
    return tuple(table)


def _leaves(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Paint one clump; return its mask (0 or 1) and its brightness (0-1)."""
    side = 192
    mask, tone = np.zeros((side, side), np.float32), np.full((side, side), 0.2, np.float32)
    for number in range(110):
        angle, away = rng.uniform(0, 2 * np.pi), side * 0.40 * np.sqrt(rng.random())
        centre = (round(side / 2 + away * np.cos(angle)), round(side / 2 + away * np.sin(angle)))
        axes = (int(rng.integers(9, 19)), int(rng.integers(5, 10)))
        turn = float(np.degrees(angle) + rng.normal(0, 50))
        bright = float(np.clip(0.15 + 0.6 * number / 110 + rng.normal(0, 0.16), 0, 0.99))
        cv2.ellipse(mask, centre, axes, turn, 0, 360, 1.0, -1)
        cv2.ellipse(tone, centre, axes, turn, 0, 360, bright, -1)
    return mask, tone


def draw_foliage(
    frame: Frame, camera: SceneCamera, *, foliage: Foliage, leaves: Leaves, sun: NDArray[np.float32]
) -> None:
    """Draw all clumps where they are nearer than the surface in the frame.

    Args:
        frame: Changed in place.
        sun: (n,) float32. Share of the sun's light on each clump.
    """
    pixels, depth = camera.project(foliage.centre.astype(np.float64))
    side = 2.5 * camera.focal_px * foliage.radius / np.maximum(depth, NEAR_M)
    reach = side / 2
    seen = (
        (depth > 1.0)
        & (pixels[:, 0] > -reach)
        & (pixels[:, 0] < camera.width + reach)
        & (pixels[:, 1] > -reach)
        & (pixels[:, 1] < camera.height + reach)
    )
    order = np.nonzero(seen)[0]
    order = order[np.argsort(-depth[order], kind="stable")]
    sizes = np.abs(np.log(side[order, None] / np.array(_SIDES))).argmin(axis=1)
    shaded = np.clip(foliage.colour[order, None, :] * _TONES[None, :, None], 0, 255).astype(np.uint8)
    palette = np.dstack([shaded, np.full(shaded.shape[:2], 255, np.uint8)]).view(np.uint32).reshape(-1)
    middle = np.rint(pixels[order]).astype(np.int32)
    near, lit = depth[order].astype(np.float32), sun[order]
    variant = order % _VARIANTS
    for size, variants in enumerate(leaves):
        for number, sprite in enumerate(variants):
            batch = np.nonzero((sizes == size) & (variant == number))[0].astype(np.int32)
            if batch.size:
                _stamp(frame, sprite, batch=batch, at=(middle, near), paint=(palette, lit))


def _stamp(
    frame: Frame,
    sprite: Sprite,
    *,
    batch: NDArray[np.int32],
    at: tuple[NDArray[np.int32], NDArray[np.float32]],
    paint: tuple[NDArray[np.uint32], NDArray[np.float32]],
) -> None:
    """Draw one sprite at many places, the farthest first."""
    rows, columns, tones = sprite
    (middle, near), (palette, lit) = at, paint
    height, width = frame.depth.shape
    y = middle[batch, 1, None] + rows
    x = middle[batch, 0, None] + columns
    index = y * np.int32(width) + x
    inside = (y.view(np.uint32) < height) & (x.view(np.uint32) < width)  # a negative wraps to a huge number
    clump, spot = np.nonzero(inside)
    index = index[clump, spot]
    depth = frame.depth.reshape(-1)
    source = batch[clump]
    distance = near[source]
    front = np.nonzero(distance < depth[index])[0]
    index, source = index[front], source[front]
    depth[index] = distance[front]  # of equal indices the last one is written, the nearest
    frame.colour.reshape(-1)[index] = palette[source * len(_TONES) + tones[spot[front]]]
    frame.sun.reshape(-1)[index] = lit[source]
