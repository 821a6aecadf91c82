"""One short signature per photo: its descriptors, aggregated and binarised (VLAD).

For each of a few centres the differences of the nearest descriptors to it are summed, and each sum is scaled
to length 1, so that a repeated pattern counts once (VLAD with intra-normalisation: Jégou et al. 2010;
Arandjelović and Zisserman 2013). The mean over photos carries no information and is subtracted. Only signs
are kept, 1 KB for SIFT and 0.5 KB for XFeat: they find as many right photos as the real values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import faiss
import numpy as np
from numpy.typing import NDArray

CENTRES = 64
"""Number of centres: a multiple of 64, so that signatures fill 64-bit words."""

SAMPLE_PHOTOS = 500
"""Number of photos that are enough for training."""

_SAMPLE_PER_CENTRE = 300
_ROUNDS = 10
_AGAIN = 8
"""Photos that are compared a second time, by the query's real values, over the number wanted."""

_BLOCK = 256
"""Signatures compared at once: together they fit into a processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Codebook:
    centres: NDArray[np.float32]  # (c, d) float32
    mean: NDArray[np.float32]  # (c, d) float32. Mean of the aggregated vectors of some photos.

    @property
    def signature_bytes(self) -> int:
        return self.centres.size // 8


def train(photos: Sequence[NDArray[np.uint8]]) -> Codebook:
    """Train a codebook.

    Args:
        photos: sequence of (n, d) uint8. Descriptors of some photos, together at least one.
    """
    sample = np.concatenate(photos)
    most = CENTRES * _SAMPLE_PER_CENTRE
    if len(sample) > most:
        sample = sample[np.random.default_rng(1).choice(len(sample), most, replace=False)]
    centres = _clustered(sample.astype(np.float32))
    mean: NDArray[np.float32] = np.stack([aggregate(centres, p) for p in photos]).mean(axis=0)
    return Codebook(centres, mean)


def _clustered(sample: NDArray[np.float32]) -> NDArray[np.float32]:
    """Find (CENTRES, d) centres by k-means; fewer descriptors than that are repeated as centres."""
    if len(sample) < CENTRES:
        return np.ascontiguousarray(np.resize(sample, (CENTRES, sample.shape[1])))
    means = faiss.Kmeans(sample.shape[1], CENTRES, niter=_ROUNDS, seed=1, min_points_per_centroid=1)
    means.train(sample)
    return np.asarray(means.centroids, np.float32)


def aggregate(centres: NDArray[np.float32], descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Sum the differences of descriptors to their nearest centre.

    Args:
        centres: (c, d) float32
        descriptors: (n, d) uint8

    Returns:
        (c, d) float32: Rows of length 1, or 0 for centres to which no descriptor is nearest.
    """
    values = descriptors.astype(np.float32)
    nearest = (values @ centres.T - 0.5 * (centres**2).sum(1)).argmax(1)
    chosen = (nearest[:, None] == np.arange(len(centres))).astype(np.float32)
    total: NDArray[np.float32] = chosen.T @ values - chosen.sum(0)[:, None] * centres
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total /= np.maximum(length, np.float32(1e-6))
    return total


def signature(codebook: Codebook, descriptors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Compute the signature of a photo with (n, d) descriptors: (`signature_bytes`,) uint8."""
    return np.packbits(aggregate(codebook.centres, descriptors) > codebook.mean)


def most_similar(
    codebook: Codebook,
    signatures: Sequence[NDArray[np.uint8]],
    *,
    descriptors: NDArray[np.uint8],
    visible: NDArray[np.bool_],
    most: int,
) -> NDArray[np.int64]:
    """Find the photos that are most similar to a query.

    Args:
        signatures: sequence of (p, `signature_bytes`) uint8. e photos in all; may be memory-mapped.
        descriptors: (n, d) uint8. Of the query.
        visible: (e,) bool. Which photos are searched.

    Returns:
        (m,) int64: The most similar first; at most `most`.
    """
    vector = aggregate(codebook.centres, descriptors)
    # The signs of centres without a descriptor of the query mean nothing.
    filled = np.repeat(vector.any(axis=1), vector.shape[1])
    vector = np.where(filled, (vector - codebook.mean).ravel(), np.float32(0.0))
    different = np.concatenate(
        [
            np.zeros(0, np.int32),
            *(_different(s, np.packbits(vector > 0.0), np.packbits(filled)) for s in signatures),
        ]
    )
    candidates = np.flatnonzero(visible)
    if len(candidates) > _AGAIN * most:
        part = np.argpartition(different[candidates], _AGAIN * most)[: _AGAIN * most]
        candidates = np.sort(candidates[part])
    likeness = _likeness(signatures, candidates, vector)
    return candidates[np.argsort(-likeness, kind="stable")[:most]]


def _different(
    signatures: NDArray[np.uint8], query: NDArray[np.uint8], filled: NDArray[np.uint8]
) -> NDArray[np.int32]:
    """Count the bits in which (p, b) signatures differ from the query's, among its `filled` ones; (p,)."""
    ours, mask = query.view(np.uint64), filled.view(np.uint64)
    counts = np.empty(len(signatures), np.int32)
    for start in range(0, len(signatures), _BLOCK):
        block = np.ascontiguousarray(signatures[start : start + _BLOCK]).view(np.uint64)
        counts[start : start + _BLOCK] = np.bitwise_count((block ^ ours) & mask).sum(axis=1, dtype=np.int32)
    return counts


def _likeness(
    signatures: Sequence[NDArray[np.uint8]], photos: NDArray[np.int64], vector: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Compute scalar products of some photos' signatures with the query's values; (len(photos),) float32."""
    likeness = np.empty(len(photos), np.float32)
    first = 0
    for part in signatures:
        here = np.flatnonzero((photos >= first) & (photos < first + len(part)))
        for start in range(0, len(here), _BLOCK // 8):
            some = here[start : start + _BLOCK // 8]
            likeness[some] = np.unpackbits(part[photos[some] - first], axis=1) @ vector
        first += len(part)
    return likeness
