"""Rotations and their logarithms, vectorised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SMALL = 1e-8

Array = NDArray[np.float64]


def exp(turn: Array) -> Array:
    """Convert (..., 3) rotation vectors, radians, to (..., 3, 3) matrices (exponential map, Rodrigues)."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    cross = np.zeros((*turn.shape[:-1], 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -turn[..., 2], turn[..., 1], -turn[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    safe = np.maximum(angle, _SMALL)
    first = np.where(angle < _SMALL, 1.0, np.sin(safe) / safe)
    second = np.where(angle < _SMALL, 0.5, (1.0 - np.cos(safe)) / safe**2)
    rotation: Array = np.eye(3) + first * cross + second * cross @ cross
    return rotation


def log(rotation: Array) -> Array:
    """Convert (..., 3, 3) matrices to (..., 3) rotation vectors, radians (logarithm); inaccurate near pi."""
    trace = np.trace(rotation, axis1=-2, axis2=-1)
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    axis = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        -1,
    )
    factor = np.where(angle < _SMALL, 0.5, angle / (2.0 * np.maximum(np.sin(angle), _SMALL)))
    turn: Array = axis * factor[..., None]
    return turn


def from_heading(heading: Array) -> Array:
    """Compute (..., 3, 3) camera-from-world rotations of level cameras from headings, radians from north."""
    c, s = np.cos(heading), np.sin(heading)
    none, one = np.zeros_like(c), np.ones_like(c)
    rows = [np.stack([c, none, -s], -1), np.stack([none, one, none], -1), np.stack([s, none, c], -1)]
    return np.stack(rows, -2)


def heading(rotation: Array) -> Array:
    """Compute the headings of (..., 3, 3) camera-from-world rotations, radians clockwise from north."""
    forward = rotation[..., 2, :]
    angle: Array = np.arctan2(forward[..., 0], forward[..., 2])
    return angle


def wrap(angle: Array) -> Array:
    """Wrap angles, radians, to -pi to pi."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def retract(rotation: Array, turn: Array) -> Array:
    """Update (..., 3, 3) camera-from-world rotations by (..., 3) rotation vectors in the world, radians."""
    after: Array = rotation @ np.swapaxes(exp(turn), -1, -2)
    return after


def clamp_norm(step: Array, most: float) -> Array:
    """Scale (n, d) steps down to a norm of at most `most`."""
    length: Array = np.sqrt((step**2).sum(1, keepdims=True))
    factor: Array = most / np.maximum(length, most)
    return step * factor


def solve_batched(matrix: Array, vector: Array) -> Array:
    """Solve many small linear systems (n, d, d), (n, d)."""
    return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0], np.float64)
