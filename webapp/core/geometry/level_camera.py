"""Prior for level cameras: roll and pitch near zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LevelPrior:
    """Zero-mean Gaussians over the sines of roll and pitch."""

    # `roll_sigma`, `pitch_sigma`: Standard deviations, radians.
    roll_sigma: float
    pitch_sigma: float
    weight: float = 1.0  # Factor on the information, below 1 if other terms are weighted down as well

    def normal_equations(self, rotation: Array) -> tuple[Array, Array]:
        """Linearize the prior about (n, 3, 3) camera-from-world rotations.

        Returns:
            matrix: (n, 3, 3) float64. Information of a rotation of the world, radians.
            vector: (n, 3) float64. Negative gradient.
        """
        matrix, vector = np.zeros((len(rotation), 3, 3)), np.zeros((len(rotation), 3))
        sigmas = (self.roll_sigma, self.pitch_sigma)
        for (sine, row), sigma in zip(roll_pitch_sines(rotation), sigmas, strict=True):
            information = self.weight / sigma**2
            matrix += information * row[:, :, None] * row[:, None, :]
            vector -= information * row * sine[:, None]
        return matrix, vector


def roll_pitch_sines(rotation: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Compute the sines of roll, then pitch, of (n, 3, 3) camera-from-world rotations, with derivatives.

    Returns:
        two pairs of (n,) and (n, 3) float64: The sine of the angle, and its derivative by a rotation of the
            world, radians.
    """
    right, forward = rotation[:, 0, :], rotation[:, 2, :]
    none = np.zeros(len(rotation))
    by_rotation = [np.stack([-v[:, 2], none, v[:, 0]], -1) for v in (right, forward)]
    return (right[:, 1], by_rotation[0]), (forward[:, 1], by_rotation[1])
