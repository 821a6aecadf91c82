"""The park, independently of the light."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.foliage import Foliage, Leaves, grow, make_leaf_sprites
from webapp.sample.scene.furniture import along_paths, fence, monument, trunks
from webapp.sample.scene.ground import Ground, lay_ground
from webapp.sample.scene.masonry import Colour, Lintel, Material, Style
from webapp.sample.scene.noise import fractal, jitter, tint
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M, ParkPlan, draw_plan
from webapp.sample.scene.raster import Quad, Texture
from webapp.sample.scene.solids import house_quads

_RADIUS_M, _HEIGHT_M, _PIECES = 98.0, 15.0, 28
_PIXELS_PER_METRE = 12


def ring(rng: np.random.Generator) -> list[Quad]:
    """Build a backdrop of woods and houses around the park, facing inwards."""
    angle = -np.arange(_PIECES + 1) * 2 * np.pi / _PIECES  # clockwise, as seen from the middle
    middle = np.array([WIDTH_M / 2, DEPTH_M / 2])
    posts = middle + _RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wide = round(float(np.linalg.norm(posts[1] - posts[0])) * _PIXELS_PER_METRE)
    panorama = _panorama(rng, wide * _PIECES)
    quads = []
    for number in range(_PIECES):
        picture = panorama[:, number * wide : (number + 1) * wide]
        along = np.append(posts[number + 1] - posts[number], 0.0)
        up = np.array([0.0, 0.0, _HEIGHT_M])
        quads.append(Quad(np.append(posts[number], -0.3), along, up, Texture.of(picture)))
    return quads


def _panorama(rng: np.random.Generator, width: int) -> NDArray[np.uint8]:
    height = round(_HEIGHT_M * _PIXELS_PER_METRE)
    picture = np.zeros((height, width, 4), np.uint8)
    _woods(rng, picture, top=0.62, colour=(96, 116, 100))
    at = 0
    while at < width:
        _house(rng, picture, at)
        at += int(rng.integers(130, 800))
    _woods(rng, picture, top=0.30, colour=(72, 98, 56))
    return picture


def _woods(
    rng: np.random.Generator, picture: NDArray[np.uint8], *, top: float, colour: tuple[int, int, int]
) -> None:
    """Paint tree tops over the whole width; their mean height is the share `top` of the picture's."""
    height, width = picture.shape[:2]
    hills = top + 0.16 * fractal(rng, (2, width), cell_px=700, octaves=2)[0]
    crowns = np.abs(fractal(rng, (2, width), cell_px=44, octaves=2)[0])
    leaves = 0.05 * fractal(rng, (height, width), cell_px=7, octaves=2)
    line = (hills + 0.16 * np.sqrt(crowns))[None, :] + leaves
    share = 1 - np.arange(height, dtype=np.float32)[:, None] / height
    wood = share < line
    tone = (
        0.95
        + 0.34 * fractal(rng, (height, width), cell_px=30, octaves=5)
        - 0.3 * np.clip(line - share, 0, 0.5)
    )
    picture[wood, :3] = tint(colour, tone.astype(np.float32))[wood]
    picture[wood, 3] = 255


def _house(rng: np.random.Generator, picture: NDArray[np.uint8], left: int) -> None:
    """Paint a distant house: wall, windows, roof."""
    height, width = picture.shape[:2]
    wide, high = int(rng.integers(70, 150)), int(rng.integers(92, 132))
    right, top = min(left + wide, width - 1), height - high
    wall = jitter(rng, (206, 190, 166), amount=22)
    cv2.rectangle(picture, (left, top), (right, height - 1), (*wall, 255), -1)
    roof = np.array(
        [[left - 8, top], [right + 8, top], [right - wide // 5, top - 34], [left + wide // 5, top - 34]]
    )
    cv2.fillPoly(picture, [roof.astype(np.int32)], (*jitter(rng, (136, 76, 60), amount=20), 255))
    for y in range(top + 10, height - 16, 32):
        for x in range(left + 10, right - 12, 20):
            glass = jitter(rng, (78, 86, 98), amount=16)
            cv2.rectangle(picture, (x, y), (x + 9, y + 15), (*glass, 255), -1)


_NAMES = (
    "CAFE", "LIBRARY", "BOATHOUSE", "MUSEUM", "SCHOOL", "THEATRE", "NURSERY", "POST", "BAKERY", "GALLERY",
    "CHAPEL", "CINEMA", "STABLES", "ARCHIVE", "CLINIC", "MILL",
)  # fmt: skip
_LOOKS: tuple[tuple[Material, Colour, Colour, Colour], ...] = (
    ("plaster", (226, 198, 136), (240, 236, 226), (46, 92, 70)),
    ("brick", (158, 84, 64), (222, 214, 200), (40, 60, 96)),
    ("boards", (104, 136, 150), (238, 238, 232), (146, 52, 44)),
    ("stone", (178, 168, 150), (226, 220, 206), (84, 60, 44)),
    ("plaster", (208, 152, 136), (242, 234, 226), (66, 60, 84)),
    ("brick", (186, 152, 104), (236, 230, 214), (58, 92, 64)),
    ("boards", (124, 142, 104), (240, 238, 228), (92, 66, 46)),
    ("plaster", (226, 222, 212), (120, 132, 140), (44, 84, 122)),
)
_ROOFS: tuple[Colour, ...] = ((146, 84, 66), (94, 94, 98), (128, 96, 78), (118, 82, 72))
_PANES = ((1, 1), (1, 2), (2, 2), (2, 3), (3, 2), (3, 4), (2, 1), (1, 3))
_LINTELS: tuple[Lintel, ...] = ("none", "beam", "gable", "arch")


@dataclass(frozen=True, slots=True)
class World:
    plan: ParkPlan
    ground: Ground
    quads: tuple[Quad, ...]  # All flat surfaces above the ground
    corners: NDArray[np.float64]  # (n, 4, 3) float64. Of the quads, metres.
    normals: NDArray[np.float64]  # (n, 3) float64. Of the quads; zero for two-sided ones.
    foliage: Foliage
    leaves: Leaves  # Pictures of clumps of leaves


def build_world(rng: np.random.Generator) -> World:
    for_plan, for_ground, for_houses, for_rest, for_leaves = rng.spawn(5)
    plan = draw_plan(for_plan)
    quads: list[Quad] = []
    styles = _styles(for_houses, len(plan.buildings))
    for house, style in zip(plan.buildings, styles, strict=True):
        quads += house_quads(for_houses, house, style=style)
    quads += fence(for_rest)
    quads += along_paths(for_rest, plan)
    quads += monument(for_rest, plan)
    quads += trunks(for_rest, plan.trees)
    quads += ring(for_rest)
    corners = np.stack([np.stack([q.corner, q.corner + q.along, q.corner + q.up]) for q in quads])
    corners = np.concatenate([corners, (corners[:, 1] + corners[:, 2] - corners[:, 0])[:, None]], axis=1)
    normals = np.stack([np.zeros(3) if q.two_sided else q.normal for q in quads])
    return World(
        plan=plan,
        ground=lay_ground(for_ground, plan),
        quads=tuple(quads),
        corners=corners,
        normals=normals,
        foliage=grow(for_leaves, plan.trees),
        leaves=make_leaf_sprites(for_leaves),
    )


def _styles(rng: np.random.Generator, count: int) -> list[Style]:
    names, looks = rng.permutation(len(_NAMES)), rng.permutation(len(_LOOKS))
    styles = []
    for number in range(count):
        material, wall, trim, door = _LOOKS[int(looks[number % len(_LOOKS)])]
        shutters = material in {"boards", "plaster"} and bool(rng.random() < 0.6)
        style = Style(
            name=_NAMES[int(names[number % len(_NAMES)])],
            material=material,
            wall=jitter(rng, wall, amount=8),
            trim=jitter(rng, trim, amount=4),
            door=jitter(rng, door, amount=8),
            roof=jitter(rng, _ROOFS[int(rng.integers(len(_ROOFS)))], amount=2),
            window_m=(float(rng.uniform(0.95, 1.25)), float(rng.uniform(1.35, 1.75))),
            spacing_m=float(rng.uniform(2.2, 2.7)),
            panes=_PANES[int(rng.integers(len(_PANES)))],
            lintel=_LINTELS[int(rng.integers(len(_LINTELS)))],
            frame_px=int(rng.integers(3, 8)),
            flower_boxes=float(rng.choice([0.0, 0.2, 0.5])),
            shutters=shutters,
        )
        styles.append(replace(style, spacing_m=style.spacing_m + 0.7) if shutters else style)
    return styles
