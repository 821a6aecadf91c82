"""Rotations and their logarithms, many at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SMALL = 1e-8

Array = NDArray[np.float64]


def exp(turn: Array) -> Array:
    """Turn (..., 3) rotation vectors, radians, into (..., 3, 3) matrices (Rodrigues)."""
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
    """Turn (..., 3, 3) matrices into (..., 3) rotation vectors, radians; next to half a turn it is rough."""
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
    """Give (..., 3, 3) camera-from-world rotations of level cameras by their headings, radians from north."""
    c, s = np.cos(heading), np.sin(heading)
    none, one = np.zeros_like(c), np.ones_like(c)
    rows = [np.stack([c, none, -s], -1), np.stack([none, one, none], -1), np.stack([s, none, c], -1)]
    return np.stack(rows, -2)


def heading(rotation: Array) -> Array:
    """Tell the headings of (..., 3, 3) camera-from-world rotations, radians clockwise from north."""
    forward = rotation[..., 2, :]
    angle: Array = np.arctan2(forward[..., 0], forward[..., 2])
    return angle


def wrap(angle: Array) -> Array:
    """Bring angles into -pi to pi."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def retract(rotation: Array, turn: Array) -> Array:
    """Turn the world by (..., 3) vectors, radians, in (..., 3, 3) camera-from-world rotations."""
    after: Array = rotation @ np.swapaxes(exp(turn), -1, -2)
    return after


def roll_pitch_sines(rotation: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Tell how far (n, 3, 3) camera-from-world rotations are from level: roll, then pitch.

    Each is its sine (n,), and the derivative of that by turns of the world (n, 3).
    """
    right, forward = rotation[:, 0, :], rotation[:, 2, :]
    none = np.zeros(len(rotation))
    by_turn = [np.stack([-v[:, 2], none, v[:, 0]], -1) for v in (right, forward)]
    return (right[:, 1], by_turn[0]), (forward[:, 1], by_turn[1])


def clamp_norm(step: Array, most: float) -> Array:
    """Cut (n, d) steps to a greatest length."""
    length: Array = np.sqrt((step**2).sum(1, keepdims=True))
    factor: Array = most / np.maximum(length, most)
    return step * factor


def solve_batched(matrix: Array, vector: Array) -> Array:
    """Solve many small linear systems (n, d, d), (n, d)."""
    return np.asarray(np.linalg.solve(matrix, vector[..., None])[..., 0], np.float64)
