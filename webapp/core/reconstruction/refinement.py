"""All matches of all pairs together correct orientations and heights; positions on the map are known.

Structure-less: each match is held to the plane through both cameras (Sampson's distance of the epipolar
constraint), so that no 3D points are needed (Rodríguez, López-de-Teruel, Ruiz, "Reduced epipolar cost for
accelerated incremental SfM", 2011). Photos are corrected side by side, each against the others as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.epipolar import sampson_error
from webapp.core.reconstruction.pairs import PhotoPairs, homogeneous

Array = NDArray[np.float64]

_ROUNDS = 30
_NOISE = 1.0 / 450.0
"""Spread of a right match, at depth 1: a pixel of a photo of 680 pixels."""

_WIDER, _NARROWING = 8.0, 0.85
_ROLL_SPREAD, _PITCH_SPREAD = 0.03, 0.3
_HEIGHT_SPREAD = 0.2
"""Of the cameras' heights, in place radii."""

_DAMPING = 0.6
_STIFFNESS = 1.05
_MOST_TURN, _MOST_RISE = 0.1, 0.1
_TRUSTED_MATCHES = 5.0
"""A pair with this many matches counts as much as its trust says; others by the root of their number."""


def refine_extrinsics(
    pairs: PhotoPairs, position: Array, *, rotation: Array, scale_px: float
) -> tuple[Array, Array]:
    """Correct orientations by all matches.

    Parameters
    ----------
    pairs : Pairs
        Of photos at different positions.
    position : (p, 2) float64
        Map pixels.
    rotation : (p, 3, 3) float64
        Camera from world, to begin with.
    scale_px : float
        The place radius.

    Returns
    -------
    rotation : (p, 3, 3) float64
    height : (p,) float64
        Downwards, map pixels.
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    weight = np.repeat(_TRUSTED_MATCHES * pairs.trust / np.sqrt(np.maximum(lengths, 1)), lengths)
    ours, theirs = homogeneous(pairs.ray_first), homogeneous(pairs.ray_second)
    world = np.column_stack([position[:, 0], np.zeros(len(position)), -position[:, 1]])
    length = np.linalg.norm(world[second] - world[first], axis=1)
    for number in range(_ROUNDS):
        spread = _NOISE * max(1.0, _WIDER * _NARROWING**number)
        found = sampson_error(
            np.einsum("mji,mj->mi", rotation[first], ours),
            np.einsum("mji,mj->mi", rotation[second], theirs),
            along=(world[second] - world[first]) / length[:, None],
            cameras=(rotation[first], rotation[second]),
        )
        strength = weight / (1.0 + (found.value / spread) ** 2) / spread**2
        rise = (found.d_height / length)[:, None]
        normal = _Equations.empty(len(world))
        normal.add(first, np.column_stack([found.d_first, -rise]), value=found.value, strength=strength)
        normal.add(second, np.column_stack([found.d_second, rise]), value=found.value, strength=strength)
        normal.add_priors(rotation, world[:, 1], height_spread=_HEIGHT_SPREAD * scale_px)
        step = _DAMPING * so3.solve_batched(normal.matrix, normal.vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step[:, :3], _MOST_TURN))
        world[:, 1] += np.clip(step[:, 3], -_MOST_RISE * scale_px, _MOST_RISE * scale_px)
    return rotation, world[:, 1]


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of p photos: three turns and the height of each.

    Attributes
    ----------
    matrix : (p, 4, 4) float64
    vector : (p, 4) float64
    """

    matrix: Array
    vector: Array

    @classmethod
    def empty(cls, photos: int) -> _Equations:
        return cls(np.zeros((photos, 4, 4)), np.zeros((photos, 4)))

    def add(self, photo: NDArray[np.int64], jacobian: Array, *, value: Array, strength: Array) -> None:
        """Add what matches say to the equations of their photos."""
        count = len(self.vector)
        weighted = strength[:, None] * jacobian
        for row in range(4):
            self.vector[:, row] -= np.bincount(photo, weights=weighted[:, row] * value, minlength=count)
            for column in range(row, 4):
                values = weighted[:, row] * jacobian[:, column]
                total = np.bincount(photo, weights=values, minlength=count)
                self.matrix[:, row, column] += total
                if column != row:
                    self.matrix[:, column, row] += total

    def add_priors(self, rotation: Array, height: Array, *, height_spread: float) -> None:
        """Add that cameras are held about level and equally high; every photo is solvable then."""
        for (sine, row), spread in zip(
            so3.roll_pitch_sines(rotation), (_ROLL_SPREAD, _PITCH_SPREAD), strict=True
        ):
            self.matrix[:, :3, :3] += row[:, :, None] * row[:, None, :] / spread**2
            self.vector[:, :3] -= row * sine[:, None] / spread**2
        self.matrix[:, 3, 3] += 1.0 / height_spread**2
        self.vector[:, 3] -= height / height_spread**2
        self.matrix[...] += 1e-3 * np.eye(4)
        turns = np.arange(3)
        self.matrix[:, turns, turns] *= _STIFFNESS
