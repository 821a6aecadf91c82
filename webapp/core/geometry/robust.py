"""Robust kernels and graduated non-convexity, for estimation in the presence of outliers.

A kernel is given as the weight of a residual in iteratively reweighted least squares; `squared` is the
squared residual, `sigma` the standard deviation of an inlier, in the same unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GATE_2D = 13.816
"""Squared Mahalanobis distance in the plane that one inlier in a thousand exceeds (chi-square, 2 degrees)."""


def geman_mcclure(squared: Array, sigma: float | Array) -> Array:
    """Compute the Geman-McClure weight, 1 to 0: outliers are rejected altogether (redescending)."""
    weight: Array = 1.0 / (1.0 + squared / sigma**2) ** 2
    return weight


def cauchy(squared: Array, sigma: float | Array) -> Array:
    """Compute the Cauchy weight, 1 to 0: outliers keep a little influence."""
    weight: Array = 1.0 / (1.0 + squared / sigma**2)
    return weight


def truncated_quadratic(squared: Array, limit: float | Array) -> Array:
    """Score a residual, 1 to 0 at `limit` and beyond (MSAC: Torr and Zisserman, "MLESAC", 2000)."""
    score: Array = np.maximum(0.0, 1.0 - squared / limit**2)
    return score


@dataclass(frozen=True, slots=True)
class Annealing:
    """Graduated non-convexity: sigma starts wide, where the cost is nearly convex, and shrinks to its value.

    Blake and Zisserman, "Visual Reconstruction", 1987; Yang, Antonante, Tzoumas, Carlone, "Graduated
    Non-Convexity for Robust Spatial Perception", 2020.
    """

    rounds: int  # Iterations in all
    start: float  # Factor on sigma in the first round
    decay: float  # Ratio of the factors of consecutive rounds, until the factor is 1

    def factors(self) -> Iterator[float]:
        """Yield the factor on sigma of each round."""
        for number in range(self.rounds):
            yield max(1.0, self.start * self.decay**number)
