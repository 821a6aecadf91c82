"""SURF (Bay et al. 2008): blobs found by box filters and described by Haar wavelets, all by integral images.

The sign of the Laplacian, by which the paper separates bright from dark blobs, is not kept: the wavelets
separate them as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.hessian import detect_blobs
from webapp.core.features.types import Described, Kind, detect_with_fallback_threshold, unit_as_bytes

_PATCH = 20.0
"""The described patch, times the scale."""

_RADIUS = 6
"""The orientation is that of the wavelets so far from the keypoint, times the scale."""

_RADIUS_SIGMA, _PATCH_SIGMA = 2.0, 3.3
"""Of the Gaussians that weigh wavelets by their distance, times the scale."""

_BINS, _WINDOW = 72, 12
"""Directions of wavelets are summed in so many bins, and over a window of 60 degrees."""

_DETERMINANT = (26.0, 0.26)
"""Smallest determinant of a keypoint: below it is mostly noise; and in dim photos, of a tenth of contrast."""

_REGIONS = 4
_AT_ONCE = 256
"""Keypoints described at once: their samples then stay in the processor's cache."""


class Surf:
    """Detector and extractor."""

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
    """Find the direction in which brightness rises around (n, 2) pixels, (n,) radians, y downwards."""
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
    """Sum, for every keypoint and bin, that bin and those after it that are in the window; (n, bins)."""
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
    """Sum wavelets over 4 x 4 regions of the turned patch, (n, 64) of length 1."""
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
    """Answer of Haar wavelets of 2 `half` pixels at (n, m, 2) pixels: right - left, below - above."""
    height, width = (side - 1 for side in integral.shape)
    reach = np.maximum(half, 1.0).astype(np.int32)[:, None]
    # Corners are counted between pixels: that after pixel x is x + 1.
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
