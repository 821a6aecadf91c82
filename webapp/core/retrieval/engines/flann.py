"""FLANN (Muja and Lowe 2009): randomised kd-trees for float, locality-sensitive hashing for binary."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Kind
from webapp.core.retrieval.engines.types import Neighbours, no_neighbours
from webapp.threads import cores, in_threads

_KD_TREES = {"algorithm": 1, "trees": 8, "random_seed": 0}
_LSH = {"algorithm": 6, "table_number": 12, "key_size": 20, "multi_probe_level": 2}
_CHECKS = {"checks": 32}


class Flann:
    """Approximate k nearest neighbours; the index is built in memory by the constructor.

    Args:
        segments: sequence of (rows, d) uint8
        kind: "float" or "binary"
    """

    def __init__(self, segments: Sequence[NDArray[np.uint8]], kind: Kind) -> None:
        self._dtype = np.float32 if kind == "float" else np.uint8
        # FLANN keeps a pointer to this array, not a copy: it has to exist as long as the index.
        width = segments[0].shape[1] if segments else 1
        self._rows = np.empty((sum(map(len, segments)), width), self._dtype)
        first = 0
        for segment in segments:
            self._rows[first : first + len(segment)] = segment
            first += len(segment)
        self._index = None
        if len(self._rows):
            cv2.setRNGSeed(0)
            self._index = cv2.flann_Index(self._rows, _KD_TREES if kind == "float" else _LSH)

    def search(self, descriptors: NDArray[np.uint8], k: int) -> Neighbours:
        """Find approximately the k nearest map descriptors of each of (n, d) uint8 descriptors."""
        found = no_neighbours(len(descriptors), k)
        if self._index is None or not len(descriptors):
            return found
        wanted = min(k, len(self._rows))
        query = np.ascontiguousarray(descriptors, self._dtype)
        row, distance = self._nearest(query, wanted)
        # LSH does not write entries for which it found nothing: their rows are negative or out of range.
        valid = (row >= 0) & (row < len(self._rows))
        plain = distance.astype(np.float32)
        if self._dtype is np.float32:
            plain = np.sqrt(np.maximum(plain, 0.0))
        found.distance[:, :wanted] = np.where(valid, plain, np.inf)
        found.row[:, :wanted] = np.where(valid, row, -1)
        return found

    def _nearest(self, query: NDArray[np.generic], k: int) -> tuple[NDArray[np.int32], NDArray[np.generic]]:
        """Search parts of the query in parallel: the searches of descriptors are independent."""
        index = self._index
        assert index is not None
        parts = np.array_split(query, min(cores(), len(query)))
        rows, distances = zip(
            *in_threads(lambda part: index.knnSearch(part, k, params=_CHECKS), parts), strict=True
        )
        return np.concatenate(rows), np.concatenate(distances)
