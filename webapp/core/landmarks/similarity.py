"""Similarities in any number of dimensions, in closed form.

S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE PAMI 13,
1991; here with weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FLAT = 1e-9
"""Fraction of the largest singular value below which another one counts as zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """Maps x to `scale * rotation @ x + shift`."""

    scale: float
    rotation: Array  # (d, d) float64. Proper, never a reflection.
    shift: Array  # (d,) float64

    def apply(self, points: Array) -> Array:
        """Map (n, d) points."""
        moved: Array = self.scale * points @ self.rotation.T + self.shift
        return moved


@dataclass(frozen=True, slots=True)
class NoSimilarity:
    """The points do not determine a similarity, and the reason. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Return False: there is none."""
        return False


def fit_similarity(source: Array, target: Array, *, weight: Array | None = None) -> Similarity | NoSimilarity:
    """Fit a similarity by least squares.

    Args:
        source, target: (n, d) float64
        weight: (n,) float64. At least 0; by default all count the same.
    """
    dimensions = source.shape[1]
    share = np.full(len(source), 1.0) if weight is None else weight
    if np.count_nonzero(share) < dimensions:
        return NoSimilarity(f"fewer than {dimensions} points")
    share = share / share.sum()
    middle, goal = share @ source, share @ target
    off, wanted = source - middle, target - goal
    covariance = (share[:, None] * wanted).T @ off
    left, spread, right = np.linalg.svd(covariance)
    # two points suffice in the plane, three not on a line in space: the last singular value may be zero
    needed = dimensions - 2
    if spread[0] <= 0.0 or spread[needed] <= _FLAT * spread[0]:
        return NoSimilarity("the points are at one spot" if dimensions == 2 else "the points are in a line")
    signs = np.ones(dimensions)
    signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right))
    rotation = left @ (signs[:, None] * right)
    scale = float((spread * signs).sum() / (share @ (off**2).sum(1)))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)
