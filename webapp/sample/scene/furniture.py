"""Smaller things in the park: trunks, fence, benches, lamps, boards, the monument."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.masonry import courses, surface
from webapp.sample.scene.noise import fractal, jitter, tint
from webapp.sample.scene.plan import DEPTH_M, PATH_WIDTH_M, WIDTH_M, ParkPlan, Tree
from webapp.sample.scene.raster import Quad, Texture
from webapp.sample.scene.solids import box_quads, lift

_UP = np.array([0.0, 0.0, 1.0])
FENCE_M = 1.25
"""Height of the fence around the park."""


def trunks(rng: np.random.Generator, trees: tuple[Tree, ...]) -> list[Quad]:
    """Make a six-sided trunk for each tree."""
    dark = [_bark(rng, (102, 84, 66)) for _ in range(6)]
    pale = [_bark(rng, (206, 204, 196), marks=True) for _ in range(6)]
    quads = []
    for tree in trees:
        if tree.kind in {"bush", "flowers"}:
            continue
        radius = 0.05 * tree.height * (0.35 if tree.kind == "birch" else 0.5)
        angle = np.arange(7) * np.pi / 3 + rng.uniform(0, 1)
        ring = np.array([tree.east, tree.north]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        barks = pale if tree.kind == "birch" else dark
        for number in range(6):
            along = lift(ring[number + 1] - ring[number], 0.0)
            bark = barks[int(rng.integers(len(barks)))]
            quads.append(Quad(lift(ring[number], 0.0), along, _UP * tree.height * 0.6, bark))
    return quads


def _bark(rng: np.random.Generator, colour: tuple[int, int, int], *, marks: bool = False) -> Texture:
    shape = (220, 16)
    tone = 1 + 0.25 * fractal(rng, (shape[0] // 6, shape[1]), cell_px=4, octaves=2)
    wood = tint(colour, cv2.resize(tone, (shape[1], shape[0])).astype(np.float32))
    if marks:
        for y in rng.integers(4, shape[0] - 4, 15):
            x = int(rng.integers(0, 12))
            cv2.line(wood, (x, int(y)), (x + 5, int(y)), (44, 42, 40), int(rng.integers(1, 4)))
    return Texture.of(wood)


def fence_corners() -> NDArray[np.float64]:
    """Return the corners of the fence, (4, 2) metres, counter-clockwise."""
    inset = 0.8
    east, north = WIDTH_M - inset, DEPTH_M - inset
    return np.array([[inset, inset], [east, inset], [east, north], [inset, north]])


def fence(rng: np.random.Generator) -> list[Quad]:
    """Build a wooden fence around the park, each board in its own tone."""
    corners = fence_corners()
    quads = []
    for left, right in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.linalg.norm(right - left))
        pieces = int(length // 10)
        step = lift(right - left, 0.0) / pieces
        for piece in range(pieces):
            picture = _pickets(rng, length / pieces)
            quads.append(Quad(lift(left, 0.0) + piece * step, step, _UP * FENCE_M, picture, two_sided=True))
    return quads


def _pickets(rng: np.random.Generator, length: float) -> Texture:
    height, width = 40, round(length * 32)
    tone, _ = courses(rng, (height, width), size_px=(7.0, 1e6, 0.0), spread=0.14)
    wood = tint(
        jitter(rng, (150, 126, 98), amount=5),
        tone + 0.08 * fractal(rng, (height, width), cell_px=20, octaves=3),
    )
    x, y = np.arange(width)[None, :], np.arange(height)[:, None]
    board = (x % 7 < 5) & (y >= 2 + np.abs(x % 7 - 2))
    rail = ((y > 8) & (y < 12)) | ((y > 29) & (y < 33))
    wood[rail & ~board] = (wood[rail & ~board] * 0.6).astype(np.uint8)
    return Texture.of(np.dstack([wood, np.where(board | rail, 255, 0).astype(np.uint8)]))


def along_paths(rng: np.random.Generator, plan: ParkPlan) -> list[Quad]:
    """Put benches, lamps and notice boards along the paths."""
    quads = []
    for line in (plan.loop, plan.link):
        for at in range(12, len(line) - 6, 22):
            ahead = line[at + 1] - line[at - 1]
            ahead = ahead / np.linalg.norm(ahead)
            out = np.array([-ahead[1], ahead[0]]) * rng.choice([-1.0, 1.0])
            spot = line[at] + out * (PATH_WIDTH_M / 2 + 0.8)
            if not _free(plan, spot):
                continue
            kind = rng.random()
            if kind < 0.4:
                quads += _bench(rng, spot, out)
            elif kind < 0.72:
                quads += _lamp(rng, spot, ahead)
            else:
                quads += _board(rng, spot, out)
    return quads


def _free(plan: ParkPlan, spot: NDArray[np.float64]) -> bool:
    off_paths = np.linalg.norm(plan.paths - spot, axis=1).min() > PATH_WIDTH_M / 2 + 0.4
    off_square = np.linalg.norm(plan.square - spot) > plan.square_radius + 1.8
    off_water = np.linalg.norm(plan.pond - spot, axis=1).min() > 1.5
    dry = np.linalg.norm(plan.pond.mean(axis=0) - spot) > 8
    return bool(
        off_paths
        and off_square
        and off_water
        and dry
        and all(h.distance(spot[None])[0] > 1.5 for h in plan.buildings)
    )


def _bench(rng: np.random.Generator, spot: NDArray[np.float64], out: NDArray[np.float64]) -> list[Quad]:
    """Build a bench that faces the path."""
    side = np.array([-out[1], out[0]])  # the path is on the side of -out
    tone, joint = courses(rng, (28, 100), size_px=(1e6, 7.0, 1.3), spread=0.1)
    tone[joint] *= 0.35
    planks = Texture.of(
        tint(jitter(rng, (150, 92, 52), amount=14), tone + 0.05 * fractal(rng, (28, 100), cell_px=24))
    )
    legs = Texture.of(np.full((8, 8, 3), 58, np.uint8))
    quads = []
    for place in (-0.75, 0.75):
        foot = spot + side * place
        quads += box_quads(lift(foot, 0.0), side, size=(0.08, 0.42, 0.44), texture=legs)
    quads += box_quads(lift(spot, 0.44), side, size=(1.8, 0.46, 0.06), texture=planks)
    quads += box_quads(lift(spot + out * 0.24, 0.56), side, size=(1.8, 0.05, 0.42), texture=planks)
    return quads


def _lamp(rng: np.random.Generator, spot: NDArray[np.float64], side: NDArray[np.float64]) -> list[Quad]:
    iron = Texture.of(tint((46, 58, 54), 1 + 0.2 * fractal(rng, (120, 8), cell_px=12, octaves=2)))
    glass = np.full((24, 24, 3), (232, 226, 200), np.uint8)
    cv2.rectangle(glass, (0, 0), (23, 23), (40, 48, 46), 3)
    top = box_quads(lift(spot, 3.2), side, size=(0.34, 0.34, 0.45), texture=Texture.of(glass))
    foot = box_quads(lift(spot, 0.0), side, size=(0.26, 0.26, 0.5), texture=iron)
    cap = box_quads(lift(spot, 3.65), side, size=(0.46, 0.46, 0.08), texture=iron)
    return [*foot, *box_quads(lift(spot, 0.5), side, size=(0.1, 0.1, 2.7), texture=iron), *top, *cap]


def _board(rng: np.random.Generator, spot: NDArray[np.float64], out: NDArray[np.float64]) -> list[Quad]:
    """Build a notice board with a random picture and some lines of text."""
    paper = np.full((76, 104, 3), jitter(rng, (222, 214, 190), amount=14), np.uint8)
    for _ in range(12):
        spots = rng.integers((6, 8), (60, 70), (int(rng.integers(3, 6)), 2)).astype(np.int32)
        cv2.fillPoly(paper, [spots], jitter(rng, (120, 126, 104), amount=50), cv2.LINE_AA)
    for y in range(18, 70, 9):
        word = "".join(chr(97 + letter) for letter in rng.integers(0, 26, 5))
        cv2.putText(paper, word, (64, y), cv2.FONT_HERSHEY_PLAIN, 0.7, (36, 36, 40), 1, cv2.LINE_AA)
    cv2.rectangle(paper, (0, 0), (103, 75), (72, 52, 36), 6)
    side = np.array([-out[1], out[0]])
    wood = Texture.of(tint((92, 68, 48), 1 + 0.2 * fractal(rng, (60, 8), cell_px=12, octaves=2)))
    quads = box_quads(lift(spot, 0.95), side, size=(1.45, 0.06, 1.06), texture=Texture.of(paper))
    for place in (-0.6, 0.6):
        quads += box_quads(lift(spot + side * place, 0.0), side, size=(0.1, 0.08, 0.95), texture=wood)
    return quads


def monument(rng: np.random.Generator, plan: ParkPlan) -> list[Quad]:
    """Raise an obelisk on a pedestal in the middle of the square."""
    side = np.array([1.0, 0.0])
    quads = []
    for low, wide, high in ((0.0, 2.6, 0.3), (0.3, 1.7, 1.3), (1.6, 0.8, 3.6)):
        for quad in box_quads(
            lift(plan.square, low),
            side,
            size=(wide, wide, high),
            texture=Texture.of(_granite(rng, wide, high)),
        ):
            picture = _granite(rng, wide, high)
            if low == 0.3:
                word = "".join(chr(65 + letter) for letter in rng.integers(0, 26, 4))
                cv2.putText(
                    picture, word, (14, 30), cv2.FONT_HERSHEY_TRIPLEX, 0.6, (62, 56, 50), 1, cv2.LINE_AA
                )
            quads.append(Quad(quad.corner, quad.along, quad.up, Texture.of(picture)))
    return quads


def _granite(rng: np.random.Generator, wide: float, high: float) -> NDArray[np.uint8]:
    shape = (max(8, round(high * 45)), max(8, round(wide * 45)))
    return surface(rng, shape, material="stone", colour=(172, 166, 158))
