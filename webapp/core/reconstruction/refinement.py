"""Refine orientations and heights by all matches of all pairs; positions on the map are known.

The adjustment is structure-less: each match contributes the Sampson error of its epipolar constraint, so that
no 3D points are needed (Rodríguez, López-de-Teruel, Ruiz, "Reduced epipolar cost for accelerated incremental
SfM", 2011). All photos are updated at once, each with the others held fixed (block Jacobi).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.epipolar import sampson_error
from webapp.core.geometry.level_camera import LevelPrior
from webapp.core.geometry.robust import cauchy
from webapp.core.reconstruction.pairs import PhotoPairs, homogeneous
from webapp.core.tuning import DEFAULT, ExtrinsicsTuning

Array = NDArray[np.float64]

_DAMPING = 0.6
"""Share of each step that is taken, because all photos move at once, each as if the others were fixed."""

_STIFFNESS = 1.05
_MOST_TURN, _MOST_RISE = 0.1, 0.1
_TRUSTED_MATCHES = 5.0
"""Factor of a match's weight, the trust in its pair over the root of the pair's number of matches."""


def refine_extrinsics(
    pairs: PhotoPairs,
    position: Array,
    *,
    rotation: Array,
    ray_sigma: Array,
    place_radius_px: float,
    tuning: ExtrinsicsTuning = DEFAULT.extrinsics,
) -> tuple[Array, Array]:
    """Refine rotations and heights by all matches.

    Args:
        pairs: Pairs of photos at different positions.
        position: (p, 2) float64. Map pixels.
        rotation: (p, 3, 3) float64. Camera from world, initial values.
        ray_sigma: (p,) float64. Standard deviation of a keypoint of each photo, at depth 1.

    Returns:
        rotation: (p, 3, 3) float64
        height: (p,) float64. Downwards, map pixels.
    """
    lengths = np.diff(pairs.start)
    first, second = np.repeat(pairs.first, lengths), np.repeat(pairs.second, lengths)
    weight = np.repeat(_TRUSTED_MATCHES * pairs.trust / np.sqrt(np.maximum(lengths, 1)), lengths)
    ours, theirs = homogeneous(pairs.ray_first), homogeneous(pairs.ray_second)
    world = np.column_stack([position[:, 0], np.zeros(len(position)), -position[:, 1]])
    length = np.linalg.norm(world[second] - world[first], axis=1)
    height_sigma = tuning.height_sigma * place_radius_px
    for factor in tuning.refinement.factors():
        error = sampson_error(
            np.einsum("mji,mj->mi", rotation[first], ours),
            np.einsum("mji,mj->mi", rotation[second], theirs),
            baseline=(world[second] - world[first]) / length[:, None],
            cameras=(rotation[first], rotation[second]),
            sigmas=(ray_sigma[first], ray_sigma[second]),
        )
        sigma = factor * error.sigma
        strength = weight * cauchy(error.value**2, sigma) / sigma**2
        rise = (error.d_height / length)[:, None]
        normal = _Equations.empty(len(world))
        normal.add(first, np.column_stack([error.d_first, -rise]), value=error.value, strength=strength)
        normal.add(second, np.column_stack([error.d_second, rise]), value=error.value, strength=strength)
        normal.add_priors(rotation, world[:, 1], level=tuning.refinement_level, height_sigma=height_sigma)
        step = _DAMPING * so3.solve_batched(normal.matrix, normal.vector)
        rotation = so3.retract(rotation, so3.clamp_norm(step[:, :3], _MOST_TURN))
        most = _MOST_RISE * place_radius_px
        world[:, 1] += np.clip(step[:, 3], -most, most)
    return rotation, world[:, 1]


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of p photos: a rotation vector and the height of each."""

    matrix: Array  # (p, 4, 4) float64
    vector: Array  # (p, 4) float64

    @classmethod
    def empty(cls, photos: int) -> _Equations:
        return cls(np.zeros((photos, 4, 4)), np.zeros((photos, 4)))

    def add(self, photo: NDArray[np.int64], jacobian: Array, *, value: Array, strength: Array) -> None:
        """Add the terms of matches to the equations of their photos."""
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

    def add_priors(self, rotation: Array, height: Array, *, level: LevelPrior, height_sigma: float) -> None:
        """Add the priors of level cameras at equal heights, which make every photo's equations solvable."""
        matrix, vector = level.normal_equations(rotation)
        self.matrix[:, :3, :3] += matrix
        self.vector[:, :3] += vector
        self.matrix[:, 3, 3] += 1.0 / height_sigma**2
        self.vector[:, 3] -= height / height_sigma**2
        self.matrix[...] += 1e-3 * np.eye(4)
        turns = np.arange(3)
        self.matrix[:, turns, turns] *= _STIFFNESS
