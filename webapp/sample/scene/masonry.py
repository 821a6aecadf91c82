"""Wall and roof surfaces (bricks, stones, boards, plaster, tiles), and the style of a building."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.noise import fractal, jitter, tint

PIXELS_PER_METRE = 45
"""Resolution of the textures of walls."""

Material = Literal["brick", "stone", "boards", "plaster"]
Colour = tuple[int, int, int]

Lintel = Literal["none", "beam", "gable", "arch"]


def surface(
    rng: np.random.Generator, shape: tuple[int, int], *, material: Material, colour: Colour
) -> NDArray[np.uint8]:
    """Make a wall without openings.

    Args:
        shape: Height and width, pixels of 1 / `PIXELS_PER_METRE` metres.
        material: "brick", "stone", "boards" or "plaster"

    Returns:
        (h, w, 3) uint8
    """
    if material == "plaster":
        tone = 1 + 0.05 * fractal(rng, shape, cell_px=120, octaves=4) + 0.03 * _grain(rng, shape)
        return _weathered(rng, tint(colour, tone))
    sizes = {"brick": (11.0, 4.0, 1.0), "stone": (28.0, 15.0, 1.4), "boards": (2000.0, 7.0, 1.0)}  # pixels
    spread = {"brick": 0.16, "stone": 0.13, "boards": 0.07}[material]
    blocks, joint = courses(rng, shape, size_px=sizes[material], spread=spread)
    tone = blocks + 0.05 * _grain(rng, shape) + 0.04 * fractal(rng, shape, cell_px=60, octaves=3)
    wall = tint(colour, tone)
    mortar: Colour = (176, 168, 156) if material != "boards" else (60, 54, 48)
    wall[joint] = (0.5 * wall[joint] + 0.5 * np.array(jitter(rng, mortar, amount=6))).astype(np.uint8)
    return _weathered(rng, wall)


def courses(
    rng: np.random.Generator, shape: tuple[int, int], *, size_px: tuple[float, float, float], spread: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Lay blocks in rows, every second row shifted by half a block.

    Args:
        shape: Height and width, pixels.
        size_px: Width and height of a block, and width of the joint.
        spread: Standard deviation of the blocks' tones.

    Returns:
        tone: (h, w) float32. One tone per block, about 1.
        joint: (h, w) bool. Joints between the blocks.
    """
    height, width = shape
    long, high, gap = size_px
    y, x = np.arange(height)[:, None], np.arange(width)[None, :]
    row = (y / high).astype(np.int64)
    along = x + np.where(row % 2 == 1, long / 2, 0.0)
    column = (along / long).astype(np.int64)
    table = rng.normal(1, spread, (int(row.max()) + 1, int(column.max()) + 1)).astype(np.float32)
    joint = (along % long < gap) | ((y % high < gap) & (x >= 0))
    return table[np.broadcast_to(row, shape), column], joint


def roof_surface(rng: np.random.Generator, shape: tuple[int, int], *, colour: Colour) -> NDArray[np.uint8]:
    """Make a tiled roof, (h, w, 3) uint8, the ridge at its top."""
    tiles, joint = courses(rng, shape, size_px=(15.0, 13.0, 1.4), spread=0.1)
    tone = tiles + 0.1 * fractal(rng, shape, cell_px=110, octaves=4)
    tone[joint] *= 0.72
    roof = tint(colour, tone)
    moss = fractal(rng, shape, cell_px=70, octaves=4) > 1.05
    roof[moss] = (0.5 * roof[moss] + 0.5 * np.array([96, 104, 62])).astype(np.uint8)
    return roof


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float32]:
    return rng.standard_normal(shape, np.float32)


def _weathered(rng: np.random.Generator, wall: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Add dirt at the foot, shade under the eaves, streaks of rain."""
    height, width = wall.shape[:2]
    from_top = np.arange(height, dtype=np.float32)[:, None] / PIXELS_PER_METRE
    from_foot = from_top[::-1]
    tone = 1 - 0.28 * np.exp(-from_foot / 0.35) - 0.3 * np.exp(-from_top / 0.3)
    streaks = np.clip(fractal(rng, (2, width), cell_px=14, octaves=3)[:1], 0, 1)
    tone = tone - 0.12 * streaks * np.exp(-from_top / 1.8)
    return np.asarray(np.clip(wall * tone[..., None], 0, 255), np.uint8)


@dataclass(frozen=True, slots=True)
class Style:
    """How the fronts of one building look."""

    name: str  # On the sign over the door
    material: Material  # "brick", "stone", "boards" or "plaster"
    # `wall`, `trim`, `door`, `roof`: Colours.
    wall: Colour
    trim: Colour
    door: Colour
    roof: Colour
    window_m: tuple[float, float] = (1.1, 1.5)  # Width and height of a window
    spacing_m: float = 2.3  # From the middle of one window to the next
    panes: tuple[int, int] = (2, 2)  # Panes of a window, across and down
    shutters: bool = False
    lintel: Lintel = "none"  # "none", "beam", "gable" or "arch". Over each window.
    frame_px: int = 5  # Width of the window frames, pixels of the texture
    flower_boxes: float = 0.0  # Share of the windows that have one


def fill_box(image: NDArray[np.uint8], box: tuple[float, float, float, float], *, colour: Colour) -> None:
    """Fill a box given as left, top, right, bottom (pixels) in an (h, w, 3) uint8 picture."""
    left, top, right, bottom = (round(side) for side in box)
    cv2.rectangle(image, (left, top), (right - 1, bottom - 1), colour, -1)


def darker(colour: Colour, factor: float) -> Colour:
    """Multiply a colour by a factor below 1."""
    return (int(colour[0] * factor), int(colour[1] * factor), int(colour[2] * factor))
