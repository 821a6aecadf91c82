"""Random patterns for textures."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def fractal(
    rng: np.random.Generator,
    shape: tuple[int, int],
    *,
    cell_px: float,
    octaves: int = 4,
    tiling: bool = False,
) -> NDArray[np.float32]:
    """Make smooth noise with detail at several scales.

    Args:
        shape: Height and width.
        cell_px: Size of the largest bumps, pixels.
        octaves: Each further one has half the size and 0.55 of the strength.
        tiling: Whether opposite edges match, so that the pattern can be repeated.

    Returns:
        (h, w) float32: Mean about 0, mostly within -1 to 1.
    """
    height, width = shape
    total = np.zeros((2, 2), np.float32)
    weight = 0.5
    for octave in range(octaves):
        cell = cell_px / 2**octave
        if cell < 1.5:
            break
        grid = (max(2, round(height / cell)), max(2, round(width / cell)))
        total = _stretch(total, grid, tiling=tiling)
        total += np.float32(weight) * rng.standard_normal(grid, np.float32)
        weight *= 0.55
    return _stretch(total, shape, tiling=tiling)


def _stretch(grid: NDArray[np.float32], shape: tuple[int, int], *, tiling: bool) -> NDArray[np.float32]:
    height, width = shape
    if not tiling:
        return np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
    rows, columns = grid.shape
    wrapped = np.pad(grid, 2, mode="wrap")
    y = (np.arange(height, dtype=np.float32) + 0.5) * (rows / height) - 0.5 + 2
    x = (np.arange(width, dtype=np.float32) + 0.5) * (columns / width) - 0.5 + 2
    found = cv2.remap(
        wrapped, np.tile(x, (height, 1)), np.tile(y[:, None], (1, width)), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(found, np.float32)


def tint(colour: tuple[int, int, int], tone: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Multiply one colour by a picture of tones.

    Args:
        tone: (h, w) float32. 1 keeps the colour.

    Returns:
        (h, w, 3) uint8
    """
    base = np.array(colour, np.float32)
    return np.asarray(np.clip(tone[..., None] * base, 0, 255), np.uint8)


def jitter(rng: np.random.Generator, colour: tuple[int, int, int], *, amount: float) -> tuple[int, int, int]:
    """Vary a colour a little, each channel by about `amount` levels."""
    varied = np.clip(np.array(colour) + rng.normal(0, amount, 3), 0, 255)
    return (int(varied[0]), int(varied[1]), int(varied[2]))
