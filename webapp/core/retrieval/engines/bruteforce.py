"""Exact search: compare with all descriptors, in blocks, directly from the memory-mapped arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import faiss
import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.types import Neighbours, merge_nearest, no_neighbours

_BLOCK_ROWS = 65_536
"""Descriptors compared at once: limits the memory to the distances of a block."""


class BruteForce:
    """Exact k nearest neighbours.

    Args:
        segments: sequence of (rows, d) uint8. The map's descriptors; may be memory-mapped.
        norm: "l1", "l2", "hamming" or "hamming2"
    """

    def __init__(self, segments: Sequence[NDArray[np.uint8]], norm: str) -> None:
        self._segments = segments
        self._compare = _COMPARE[norm]

    def search(self, descriptors: NDArray[np.uint8], k: int) -> Neighbours:
        """Find the k nearest map descriptors of each of (n, d) uint8 descriptors."""
        best = no_neighbours(len(descriptors), k)
        if not len(descriptors):
            return best
        first = 0
        for segment in self._segments:
            for start in range(0, len(segment), _BLOCK_ROWS):
                block = np.ascontiguousarray(segment[start : start + _BLOCK_ROWS])
                distance, row = self._compare(descriptors, block, min(k, len(block)))
                here = Neighbours(distance.astype(np.float32), row.astype(np.int64) + first + start)
                best = merge_nearest([best, here], k)
            first += len(segment)
        return best


_Pair = tuple[NDArray[Any], NDArray[Any]]


def _l1(query: NDArray[np.uint8], block: NDArray[np.uint8], k: int) -> _Pair:
    distance, row = faiss.knn(query.astype(np.float32), block.astype(np.float32), k, metric=faiss.METRIC_L1)
    return distance, row


def _l2(query: NDArray[np.uint8], block: NDArray[np.uint8], k: int) -> _Pair:
    squared, row = faiss.knn(query.astype(np.float32), block.astype(np.float32), k)
    return np.sqrt(np.maximum(squared, 0.0)), row


def _hamming(query: NDArray[np.uint8], block: NDArray[np.uint8], k: int) -> _Pair:
    distance, row = faiss.knn_hamming(np.ascontiguousarray(query), block, k)
    return distance, row


def _hamming2(query: NDArray[np.uint8], block: NDArray[np.uint8], k: int) -> _Pair:
    distance, row = cv2.batchDistance(query, block, dtype=cv2.CV_32S, normType=cv2.NORM_HAMMING2, K=k)
    return distance, row


_COMPARE: dict[str, Callable[[NDArray[np.uint8], NDArray[np.uint8], int], _Pair]] = {
    "l1": _l1,
    "l2": _l2,
    "hamming": _hamming,
    "hamming2": _hamming2,
}
