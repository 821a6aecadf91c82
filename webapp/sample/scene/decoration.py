"""What makes a wall its own: a sign, a poster, a mural, ivy, a pipe. All change the wall in place."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.masonry import PIXELS_PER_METRE
from webapp.sample.scene.noise import fractal, jitter
from webapp.sample.scene.style import Style, darker, fill_box

_FONT = cv2.FONT_HERSHEY_DUPLEX


def sign(wall: NDArray[np.uint8], *, middle: tuple[int, int], style: Style) -> None:
    """Hang the building's name over its door."""
    scale = 1.05
    (width, height), _ = cv2.getTextSize(style.name, _FONT, scale, 2)
    left = int(np.clip(middle[0] - width // 2, 14, max(14, wall.shape[1] - width - 14)))
    top = middle[1] - height // 2
    board = (left - 12, top - 9, left + width + 12, top + height + 11)
    fill_box(wall, board, colour=darker(style.door, 0.55))
    cv2.rectangle(wall, (board[0], board[1]), (board[2], board[3]), (232, 222, 190), 2, cv2.LINE_AA)
    cv2.putText(wall, style.name, (left, top + height), _FONT, scale, (246, 238, 214), 2, cv2.LINE_AA)


def poster(rng: np.random.Generator, wall: NDArray[np.uint8], *, middle: int) -> None:
    """Hang a notice at eye height: shapes and a few lines of letters."""
    height, width = wall.shape[:2]
    wide, high = int(rng.integers(26, 44)), int(rng.integers(36, 60))
    left = int(np.clip(middle - wide // 2, 0, width - wide))
    top = height - round(rng.uniform(1.1, 1.6) * PIXELS_PER_METRE) - high // 2
    paper = np.full((high, wide, 3), rng.integers(150, 250, 3), np.uint8)
    for _ in range(4):
        colour = jitter(rng, (128, 110, 100), amount=70)
        spot = (int(rng.integers(wide)), int(rng.integers(high // 2)))
        cv2.circle(paper, spot, int(rng.integers(3, 11)), colour, -1, cv2.LINE_AA)
    for y in range(high // 2 + 6, high - 3, 6):
        word = "".join(chr(65 + letter) for letter in rng.integers(0, 26, 6))
        cv2.putText(paper, word, (3, y), cv2.FONT_HERSHEY_PLAIN, 0.5, (30, 30, 36), 1)
    wall[top : top + high, left : left + wide] = paper


def mural(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Paint a framed landscape of plain shapes over most of the ground floor."""
    height, width = wall.shape[:2]
    wide = min(width - 2 * PIXELS_PER_METRE, round(rng.uniform(3.5, 6.0) * PIXELS_PER_METRE))
    high = round(2.1 * PIXELS_PER_METRE)
    left = int(rng.integers(PIXELS_PER_METRE // 2, max(PIXELS_PER_METRE // 2 + 1, width - wide)))
    top = height - high - round(0.4 * PIXELS_PER_METRE)
    picture = np.full((high, wide, 3), jitter(rng, (150, 190, 205), amount=40), np.uint8)
    spot = (int(rng.integers(wide)), int(rng.integers(high // 2)))
    cv2.circle(
        picture, spot, int(rng.integers(12, 30)), jitter(rng, (235, 190, 80), amount=30), -1, cv2.LINE_AA
    )
    x = np.arange(wide)
    for layer in range(4):
        hills = high * (0.3 + 0.17 * layer) + fractal(rng, (2, wide), cell_px=90, octaves=2)[0] * 22
        outline = np.column_stack([x, hills])
        polygon = np.concatenate([outline, [[wide, high], [0, high]]]).astype(np.int32)
        cv2.fillPoly(picture, [polygon], jitter(rng, (120, 115, 105), amount=50), cv2.LINE_AA)
    for _ in range(14):
        centre = (int(rng.integers(wide)), int(rng.integers(high)))
        axes = (int(rng.integers(3, 16)), int(rng.integers(3, 10)))
        colour = jitter(rng, (150, 130, 120), amount=60)
        cv2.ellipse(picture, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (wide - 1, high - 1), (236, 230, 214), 5)
    wall[top : top + high, left : left + wide] = picture


def ivy(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Let ivy grow from the foot of the wall."""
    height, width = wall.shape[:2]
    reach = fractal(rng, (2, width), cell_px=160, octaves=3)[0] * 1.7 * PIXELS_PER_METRE
    from_foot = (height - np.arange(height))[:, None]
    leaves = fractal(rng, (height, width), cell_px=9, octaves=3)
    grown = (from_foot + 12 * leaves < reach[None, :]) & (leaves > -0.5)
    tone = np.clip(0.8 + 0.45 * leaves[grown], 0.3, 1.6)
    wall[grown] = np.clip(tone[:, None] * np.array([66.0, 104.0, 48.0]), 0, 255).astype(np.uint8)


def drainpipe(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Fix a pipe to one side of the wall."""
    x = 12 if rng.random() < 0.5 else wall.shape[1] - 16
    fill_box(wall, (x, 0, x + 5, wall.shape[0]), colour=(98, 98, 96))
    fill_box(wall, (x + 5, 0, x + 7, wall.shape[0]), colour=(52, 50, 48))
