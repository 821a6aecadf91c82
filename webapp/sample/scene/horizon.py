"""What stands around the park: a ring of woods and roofs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.noise import fractal, jitter, tint
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M
from webapp.sample.scene.raster import Quad, Texture

_RADIUS_M, _HEIGHT_M, _PIECES = 98.0, 15.0, 28
_PIXELS_PER_METRE = 12


def ring(rng: np.random.Generator) -> list[Quad]:
    """Build the ring, its pictures turned inwards."""
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
    """A row of tree tops over the whole width, `top` of the height in the mean."""
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
    """A distant house: wall, windows, roof."""
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
