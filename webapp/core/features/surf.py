"""SURF (Bay et al. 2008): blobs detected by box filters and described by Haar wavelets, on integral images.

A blob is a maximum of the determinant of box-filtered second derivatives.

The sign of the Laplacian, by which the paper separates bright from dark blobs, is not stored: the wavelets
separate them as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.entry import FeatureEntry
from webapp.core.features.types import Described, Kind, detect_with_fallback_threshold, unit_as_bytes

_SIZE_OF_SCALE = 9.0 / 1.2
"""Size of a filter over its scale: the smallest, of 9 pixels, approximates a Gaussian of sigma 1.2."""

_OCTAVES = ((9, 15, 21, 27), (15, 27, 39, 51), (27, 51, 75, 99))
"""Sizes of the filters; each octave is sampled half as densely as the one before. The paper's fourth octave
finds few blobs, and locates them inaccurately."""

_BALANCE = 0.9
"""Weight of the mixed derivative, because boxes only approximate the Gaussians."""

_FARTHEST = 1.0
"""Maximum distance of an interpolated maximum from its sample, in samples."""

_PATCH = 20.0
"""Side of the described patch, times the scale."""

_RADIUS = 6
"""Radius in which wavelets determine the orientation of a keypoint, times the scale."""

_RADIUS_SIGMA, _PATCH_SIGMA = 2.0, 3.3
"""Sigmas of the Gaussians that weight wavelets by their distance, times the scale."""

_BINS, _WINDOW = 72, 12
"""Bins of the directions of wavelets, and bins in the window of 60 degrees over which they are summed."""

_DETERMINANT = (26.0, 0.26)
"""Minimum determinant of a keypoint: below it most are noise; and that in photos of a tenth of contrast."""

_REGIONS = 4
_AT_ONCE = 256
"""Keypoints described at once, so that their samples stay in the processor's cache."""


class Blobs(NamedTuple):
    """Detected blobs, the strongest first."""

    xy: NDArray[np.float32]  # (n, 2) float32. Pixels; pixel centres have whole numbers.
    scale: NDArray[np.float32]  # (n,) float32. Sigma of the Gaussian that the filter approximates, pixels.
    strength: NDArray[np.float32]  # (n,) float32


def detect_blobs(integral: NDArray[np.int32], most: int, *, least: float) -> Blobs:
    """Detect blobs of all scales.

    Args:
        integral: (h + 1, w + 1) int32. Sums of all pixels above and to the left.
        most: Maximum number; the strongest are kept.
        least: Minimum determinant of a keypoint, for grey values of 0 to 255.
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
                # reuse the layer of the octave before, which is twice as dense
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


class Surf:
    kind: Kind = "float"
    width = 64
    oriented = True

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Detect the `keypoints` strongest blobs of an (h, w) uint8 image."""
        return self._detect(cv2.integral(gray), keypoints)

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe the `keypoints` strongest blobs; descriptors (n, 64) uint8."""
        integral = cv2.integral(gray)
        found = self._detect(integral, keypoints)
        return found, self._described(integral, found)

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Describe another detector's keypoints; descriptors (n, 64) uint8."""
        return keypoints, self._described(cv2.integral(gray), keypoints)

    def _detect(self, integral: NDArray[np.int32], keypoints: int) -> list[cv2.KeyPoint]:
        blobs = detect_with_fallback_threshold(
            lambda most, least: detect_blobs(integral, most, least=least), keypoints, thresholds=_DETERMINANT
        )
        angle = np.degrees(_orientation(integral, blobs.xy, blobs.scale)) % 360.0
        return [
            cv2.KeyPoint(x, y, size, turn, strength)
            for (x, y), size, turn, strength in zip(
                blobs.xy.tolist(),
                (_PATCH * blobs.scale).tolist(),
                angle.tolist(),
                blobs.strength.tolist(),
                strict=True,
            )
        ]

    def _described(self, integral: NDArray[np.int32], keypoints: Sequence[cv2.KeyPoint]) -> NDArray[np.uint8]:
        table = np.array([(*k.pt, k.size, k.angle) for k in keypoints], np.float32).reshape(-1, 4)
        parts = [
            _descriptors(
                integral, part[:, :2], part[:, 2] / _PATCH, angle=np.radians(np.maximum(part[:, 3], 0))
            )
            for part in np.split(table, range(_AT_ONCE, len(table), _AT_ONCE))
        ]
        return unit_as_bytes(np.concatenate(parts))


def _orientation(
    integral: NDArray[np.int32], xy: NDArray[np.float32], scale: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Compute the direction of rising brightness around (n, 2) pixels, (n,) radians, y downwards."""
    y, x = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1].astype(np.float32)
    inside = x**2 + y**2 < _RADIUS**2
    grid = np.column_stack([x[inside], y[inside]])
    weight = np.exp(-(grid**2).sum(axis=1) / (2.0 * _RADIUS_SIGMA**2))
    at = xy[:, None] + scale[:, None, None] * grid
    dx, dy = (weight * part for part in _wavelets(integral, at, np.rint(2.0 * scale)))
    angle = np.arctan2(dy, dx)
    bins = np.floor(angle * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS
    cell = (bins + _BINS * np.arange(len(xy))[:, None]).ravel()
    x_sum, y_sum = (
        _in_window(np.bincount(cell, weights=part.ravel(), minlength=_BINS * len(xy))) for part in (dx, dy)
    )
    longest = (np.arange(len(xy)), np.hypot(x_sum, y_sum).argmax(axis=1))
    direction: NDArray[np.float32] = np.arctan2(y_sum[longest], x_sum[longest]).astype(np.float32)
    return direction


def _in_window(bins: NDArray[np.number]) -> NDArray[np.float64]:
    """Sum, for every keypoint and bin, the bins of the window that starts at it; (n, bins)."""
    around = bins.reshape(-1, _BINS)
    doubled = np.cumsum(np.concatenate([np.zeros((len(around), 1)), around, around[:, :_WINDOW]], 1), axis=1)
    sums: NDArray[np.float64] = doubled[:, _WINDOW:-1] - doubled[:, : -_WINDOW - 1]
    return sums


def _descriptors(
    integral: NDArray[np.int32],
    xy: NDArray[np.float32],
    scale: NDArray[np.float32],
    *,
    angle: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Sum wavelets over 4 x 4 regions of the rotated patch, (n, 64) of length 1."""
    side = int(_PATCH)
    offset = np.arange(side, dtype=np.float32) - (side - 1) / 2.0
    u, v = (part.ravel() for part in np.meshgrid(offset, offset))
    weight = np.exp(-(u**2 + v**2) / (2.0 * _PATCH_SIGMA**2))
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned = np.stack([cos * u - sin * v, sin * u + cos * v], axis=2)
    dx, dy = _wavelets(integral, xy[:, None] + scale[:, None, None] * turned, np.rint(scale))
    along, across = weight * (cos * dx + sin * dy), weight * (cos * dy - sin * dx)
    values = np.stack([along, across, np.abs(along), np.abs(across)], axis=2)
    each = side // _REGIONS
    regions = values.reshape(len(xy), _REGIONS, each, _REGIONS, each, 4).sum(axis=(2, 4))
    regions = regions.reshape(len(xy), 4 * _REGIONS**2)
    length = np.linalg.norm(regions, axis=1, keepdims=True)
    described: NDArray[np.float32] = (regions / np.maximum(length, 1e-9)).astype(np.float32)
    return described


def _wavelets(
    integral: NDArray[np.int32], at: NDArray[np.float32], half: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute Haar wavelet responses at (n, m, 2) pixels, size 2 `half`: right - left, below - above."""
    height, width = (side - 1 for side in integral.shape)
    reach = np.maximum(half, 1.0).astype(np.int32)[:, None]
    # corners are between pixels: the one after pixel x is x + 1
    corner = np.rint(at + 0.5).astype(np.int32)
    x, y = corner[:, :, 0], corner[:, :, 1]
    columns = [np.clip(x + shift, 0, width) for shift in (-reach, 0, reach)]
    rows = [np.clip(y + shift, 0, height) * (width + 1) for shift in (-reach, 0, reach)]
    flat = integral.ravel()
    above_left, above, above_right = (flat[rows[0] + column] for column in columns)
    left, right = flat[rows[1] + columns[0]], flat[rows[1] + columns[2]]
    below_left, below, below_right = (flat[rows[2] + column] for column in columns)
    dx = (below_right - below - above_right + above) - (below - below_left - above + above_left)
    dy = (below_right - below_left - right + left) - (right - left - above_right + above_left)
    return dx.astype(np.float32), dy.astype(np.float32)


def _determinant(integral: NDArray[np.int32], size: int, step: int) -> NDArray[np.float32]:
    """Compute determinants, filter size `size`, at every `step`-th pixel; 0 where the filter does not fit."""
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
    """Find the maxima over position and scale of (4, rows, columns), interpolated between samples."""
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
    return Blobs(xy.astype(np.float32), (size / _SIZE_OF_SCALE).astype(np.float32), strength)


def _neighbourhood(stack: NDArray[np.float32], place: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the samples around (n, 3) places, (n, 3, 3, 3)."""
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
    """Return the samples in the middle of all axes except those of `side`."""
    layer, row, column = (side.get(axis, 1) for axis in range(3))
    taken: NDArray[np.float64] = cut[:, layer, row, column]
    return taken


ENTRIES = (FeatureEntry("surf", Surf),)
