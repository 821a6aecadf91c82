"""The detector of SURF (Bay et al. 2008): maxima of the determinant of box-filtered second derivatives."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE_OF_SCALE = 9.0 / 1.2
"""Pixels of a filter for each pixel of scale: the smallest, of 9 pixels, stands for a Gaussian of 1.2."""

_OCTAVES = ((9, 15, 21, 27), (15, 27, 39, 51), (27, 51, 75, 99))
"""Sizes of the filters; each octave is sampled half as densely as the one before. The paper's fourth octave
finds few blobs, and places them badly."""

_BALANCE = 0.9
"""Weight of the mixed derivative: boxes approximate the Gaussians."""

_FARTHEST = 1.0
"""A maximum that is interpolated farther from its sample, in samples, is rejected."""


class Blobs(NamedTuple):
    """Detected blobs, the strongest first.

    Attributes
    ----------
    xy : (n, 2) float32
        Pixels; pixel centres have whole numbers.
    scale : (n,) float32
        Sigma of the Gaussian that the filter stands for, pixels.
    strength : (n,) float32
    """

    xy: NDArray[np.float32]
    scale: NDArray[np.float32]
    strength: NDArray[np.float32]


def detect_blobs(integral: NDArray[np.int32], most: int, *, least: float) -> Blobs:
    """Detect blobs of all scales.

    Parameters
    ----------
    integral : (h + 1, w + 1) int32
        Sums of all pixels above and to the left.
    most : int
        At most so many, the strongest.
    least : float
        Smallest determinant of a keypoint, for grey values of 0 to 255.
    """
    known: dict[tuple[int, int], NDArray[np.float32]] = {}
    parts = []
    for octave, sizes in enumerate(_OCTAVES):
        step = 1 << octave
        if min(integral.shape) <= sizes[1]:
            break
        layers = []
        for size in sizes:
            if (size, step // 2) in known:
                # The octave before has it, twice as dense.
                known[size, step] = known[size, step // 2][::2, ::2]
            else:
                known[size, step] = _determinant(integral, size, step)
            layers.append(known[size, step])
        parts.append(_maxima(np.stack(layers), sizes, step, least=least))
    if not parts:
        return Blobs(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros(0, np.float32))
    found = Blobs(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    order = np.argsort(-found.strength, kind="stable")[:most]
    return Blobs(*(column[order] for column in found))


def _determinant(integral: NDArray[np.int32], size: int, step: int) -> NDArray[np.float32]:
    """Filter with boxes of `size` pixels at every `step`-th pixel; 0 where the filter does not fit."""
    height, width = (side - 1 for side in integral.shape)
    answer = np.zeros((-(-height // step), -(-width // step)), np.float32)
    margin = -(-(size // 2) // step)
    rows, columns = ((side - 1 - size // 2) // step + 1 - margin for side in (height, width))
    if rows <= 0 or columns <= 0:
        return answer

    def box(top: int, left: int, *, tall: int, wide: int) -> NDArray[np.int32]:
        """Sum over a box whose first pixel is at (left, top) from the centre, for all centres."""
        y, x = margin * step + top, margin * step + left
        ends_y, ends_x = (rows - 1) * step + 1, (columns - 1) * step + 1
        above, below = (slice(at, at + ends_y, step) for at in (y, y + tall))
        before, after = (slice(at, at + ends_x, step) for at in (x, x + wide))
        return (
            integral[below, after]
            - integral[above, after]
            - integral[below, before]
            + integral[above, before]
        )

    lobe = size // 3
    half, wide = size // 2, 2 * lobe - 1
    middle = lobe // 2
    xx = box(1 - lobe, -half, tall=wide, wide=size) - 3 * box(1 - lobe, -middle, tall=wide, wide=lobe)
    yy = box(-half, 1 - lobe, tall=size, wide=wide) - 3 * box(-middle, 1 - lobe, tall=lobe, wide=wide)
    corners = (box(top, left, tall=lobe, wide=lobe) for top in (-lobe, 1) for left in (-lobe, 1))
    above_left, above_right, below_left, below_right = corners
    xy = above_left + below_right - above_right - below_left
    area = np.float32(1.0 / size**2)
    dxx, dyy, dxy = (part.astype(np.float32) * area for part in (xx, yy, xy))
    answer[margin : margin + rows, margin : margin + columns] = dxx * dyy - np.square(
        np.float32(_BALANCE) * dxy
    )
    return answer


def _maxima(stack: NDArray[np.float32], sizes: tuple[int, ...], step: int, *, least: float) -> Blobs:
    """Find the maxima over place and scale of (4, rows, columns), to a fraction of a sample."""
    around = [cv2.dilate(layer, np.ones((3, 3), np.uint8)) for layer in stack]
    places = []
    for middle in range(1, len(stack) - 1):
        highest = np.maximum(np.maximum(around[middle - 1], around[middle + 1]), around[middle])
        peak = (stack[middle] >= highest) & (stack[middle] > least)
        peak[[0, -1], :] = peak[:, [0, -1]] = False
        y, x = np.nonzero(peak)
        places.append(np.column_stack([np.full(len(y), middle), y, x]))
    place = np.concatenate(places)
    offset = _vertex(_neighbourhood(stack, place))
    near = (np.abs(offset) < _FARTHEST).all(axis=1)
    place, offset = place[near], offset[near]
    spacing = sizes[1] - sizes[0]
    size = np.array(sizes, np.float64)[place[:, 0]] + spacing * offset[:, 0]
    xy = (place[:, :0:-1] + offset[:, :0:-1]) * step
    strength = stack[place[:, 0], place[:, 1], place[:, 2]]
    return Blobs(xy.astype(np.float32), (size / SIZE_OF_SCALE).astype(np.float32), strength)


def _neighbourhood(stack: NDArray[np.float32], place: NDArray[np.int64]) -> NDArray[np.float64]:
    """Cut out the samples around (n, 3) places, (n, 3, 3, 3)."""
    steps = np.arange(-1, 2)
    layer, row, column = (place[:, axis, None] + steps for axis in range(3))
    cut = stack[layer[:, :, None, None], row[:, None, :, None], column[:, None, None, :]]
    exact: NDArray[np.float64] = cut.astype(np.float64)
    return exact


def _vertex(cut: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit a quadratic to (n, 3, 3, 3) samples (Brown and Lowe 2002): its vertex (n, 3), infinite if none."""
    middle = cut[:, 1, 1, 1]
    gradient, curvature = np.empty((len(cut), 3)), np.empty((len(cut), 3, 3))
    for a in range(3):
        before, after = (_at(cut, {a: side}) for side in (0, 2))
        gradient[:, a] = (after - before) / 2.0
        curvature[:, a, a] = after - 2.0 * middle + before
        for b in range(a):
            mixed = _at(cut, {a: 2, b: 2}) + _at(cut, {a: 0, b: 0})
            mixed -= _at(cut, {a: 2, b: 0}) + _at(cut, {a: 0, b: 2})
            curvature[:, a, b] = curvature[:, b, a] = mixed / 4.0
    vertex = np.full((len(cut), 3), np.inf)
    solvable = np.abs(np.linalg.det(curvature)) > 1e-9 * np.abs(middle) ** 3
    vertex[solvable] = -np.linalg.solve(curvature[solvable], gradient[solvable][:, :, None])[:, :, 0]
    return vertex


def _at(cut: NDArray[np.float64], side: dict[int, int]) -> NDArray[np.float64]:
    """Take the samples in the middle of all axes but those of `side`."""
    layer, row, column = (side.get(axis, 1) for axis in range(3))
    taken: NDArray[np.float64] = cut[:, layer, row, column]
    return taken
