"""Global descriptors of photos: similarity of a query to a map's photos, and to all photos of a library.

For a library each photo has one short vector: its descriptors are aggregated as for signatures
(`engines.vlad`), the mean is subtracted, and the principal components are kept (Jégou and Chum 2012). Vectors
have length 1, so that the scalar product of two is the cosine of their angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.global_descriptor import GlobalDescriptor
from webapp.core.retrieval.engines import vlad
from webapp.core.retrieval.engines.vlad import Codebook

_BLOCK_ROWS = 2048
"""Vectors compared at once: limits the memory for their conversion."""


@dataclass(frozen=True, slots=True, eq=False)
class GlobalDescriptors:
    """The vectors of p photos of a map, and the network that computed them."""

    network: GlobalDescriptor
    vectors: NDArray[np.float16]  # (n, d) float16. Of length 1.
    row: NDArray[np.int64]  # (p,) int64. Row of each photo in `vectors`; -1 if it has none.

    def of(self, photo: int) -> NDArray[np.float32] | None:
        """Look up a photo's vector by the photo's number; (d,), None if it has none."""
        row = int(self.row[photo])
        return None if row < 0 else self.vectors[row].astype(np.float32)

    def standard_scores(
        self, vector: NDArray[np.float32], *, visible: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Compute the similarity of a query to all photos, in standard deviations above the mean.

        Args:
            vector: (d,) float32
            visible: (p,) bool. Which photos are compared and included in mean and standard deviation.

        Returns:
            (p,) float64: Standardised cosine similarities; -inf for photos that are not visible or have no
                vector.
        """
        scores = np.full(len(self.row), -np.inf)
        known = np.flatnonzero(visible & (self.row >= 0))
        if not len(known):
            return scores
        cosine = self._cosines(vector)[self.row[known]]
        deviation = float(cosine.std())
        even = deviation <= np.finfo(np.float16).eps
        scores[known] = 0.0 if even else (cosine - cosine.mean()) / deviation
        return scores

    def _cosines(self, vector: NDArray[np.float32]) -> NDArray[np.float64]:
        blocks = [
            self.vectors[start : start + _BLOCK_ROWS].astype(np.float32) @ vector
            for start in range(0, len(self.vectors), _BLOCK_ROWS)
        ]
        return np.concatenate(blocks).astype(np.float64)


DIMENSIONS = 128

_LEAST_VARIANCE = 1e-6
"""Minimum variance of a component that is kept, over that of the first."""


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Codebook and projection by which vectors are computed."""

    codebook: Codebook
    # (c * d, `DIMENSIONS`) float32. Orthonormal columns, the largest variance first; zero if there were too
    # few photos for more.
    axes: NDArray[np.float32]


def train_basis(photos: Sequence[NDArray[np.uint8]]) -> Basis:
    """Train a basis.

    Args:
        photos: sequence of (n, d) uint8. Descriptors of some photos, together at least one.
    """
    codebook = vlad.train(photos)
    centred = np.stack([_centred(codebook, descriptors) for descriptors in photos])
    variances, mixtures = np.linalg.eigh(centred @ centred.T)  # fewer photos than dimensions
    variances, mixtures = variances[::-1][:DIMENSIONS], mixtures[:, ::-1][:, :DIMENSIONS]
    kept = variances > max(_LEAST_VARIANCE * float(variances[0]), np.finfo(np.float32).tiny)
    axes = np.zeros((centred.shape[1], DIMENSIONS), np.float32)
    axes[:, : kept.sum()] = centred.T @ (mixtures[:, kept] / np.sqrt(variances[kept]))
    return Basis(codebook, axes)


def photo_vector(basis: Basis, descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Describe a photo with (n, d) descriptors by a (`DIMENSIONS`,) vector of length 1, or 0 without any."""
    if not len(descriptors):
        return np.zeros(DIMENSIONS, np.float32)
    projected: NDArray[np.float32] = _centred(basis.codebook, descriptors) @ basis.axes
    projected /= np.maximum(np.linalg.norm(projected), np.float32(1e-12))
    return projected


def _centred(codebook: Codebook, descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    difference: NDArray[np.float32] = vlad.aggregate(codebook.centres, descriptors) - codebook.mean
    return difference.ravel()
