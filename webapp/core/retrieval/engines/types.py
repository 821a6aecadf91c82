"""Interface and results of search engines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """For each of n query descriptors its k nearest map descriptors, the nearest first."""

    # (n, k) float32. In the engine's norm (Euclidean, not squared, for L2); infinite if there is no k-th
    # neighbour.
    distance: NDArray[np.float32]
    # (n, k) int64. Number of the map descriptor, counted over the whole index; -1 if there is none.
    row: NDArray[np.int64]


class DescriptorSearch(Protocol):
    """Finds nearest neighbours among the descriptors of a map."""

    def search(self, descriptors: NDArray[np.uint8], k: int) -> Neighbours:
        """Find the k nearest map descriptors of each of (n, d) uint8 descriptors."""


def no_neighbours(n: int, k: int) -> Neighbours:
    """Return the result of an empty index for `n` descriptors."""
    return Neighbours(np.full((n, k), np.inf, np.float32), np.full((n, k), -1, np.int64))


def merge_nearest(parts: list[Neighbours], k: int) -> Neighbours:
    """Merge the results of several parts of an index into the k nearest over all.

    Args:
        parts: At least one; rows are already counted over the whole index.
    """
    distance = np.concatenate([p.distance for p in parts], axis=1)
    row = np.concatenate([p.row for p in parts], axis=1)
    if distance.shape[1] < k:
        missing = k - distance.shape[1]
        distance = np.pad(distance, ((0, 0), (0, missing)), constant_values=np.inf)
        row = np.pad(row, ((0, 0), (0, missing)), constant_values=-1)
    order = np.argsort(distance, axis=1, kind="stable")[:, :k]
    return Neighbours(np.take_along_axis(distance, order, 1), np.take_along_axis(row, order, 1))
