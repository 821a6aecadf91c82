"""One short vector per photo, by which a query is compared with all photos of a library.

The descriptors are aggregated as for signatures (`engines.vlad`), the mean is subtracted, and the principal
components are kept (Jégou and Chum 2012). Vectors have length 1, so that the scalar product of two is the
cosine of their angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines import vlad
from webapp.core.retrieval.engines.vlad import Codebook

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


def train(photos: Sequence[NDArray[np.uint8]]) -> Basis:
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


def vector(basis: Basis, descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Describe a photo with (n, d) descriptors by a (`DIMENSIONS`,) vector of length 1, or 0 without any."""
    if not len(descriptors):
        return np.zeros(DIMENSIONS, np.float32)
    projected: NDArray[np.float32] = _centred(basis.codebook, descriptors) @ basis.axes
    projected /= np.maximum(np.linalg.norm(projected), np.float32(1e-12))
    return projected


def _centred(codebook: Codebook, descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    difference: NDArray[np.float32] = vlad.aggregate(codebook.centres, descriptors) - codebook.mean
    return difference.ravel()
