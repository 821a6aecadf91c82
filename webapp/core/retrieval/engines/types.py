"""Interface and results of search engines, and the choice of one by the memory limit of an index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Engine, Kind


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


_BYTES_A_ROW = 20
"""Bytes per keypoint: its number in the inverted lists (8), position and orientation (12)."""

_WHOLE_BELOW = 20_000
"""Below this number of descriptors they are stored uncompressed: a product quantizer would not pay."""


def is_uncompressed(descriptors: int, *, kind: Kind) -> bool:
    """Decide whether an index of this many descriptors stores them uncompressed; always for binary ones."""
    return kind == "binary" or descriptors < _WHOLE_BELOW


def bytes_in_memory(descriptors: int, *, width: int, kind: Kind) -> int:
    """Estimate the memory of an inverted file from its number of descriptors.

    Args:
        width: Bytes of a descriptor, which a product quantizer reduces to a quarter.
        kind: "float" or "binary"
    """
    kept = width if is_uncompressed(descriptors, kind=kind) else width // 4
    return descriptors * (kept + _BYTES_A_ROW)


def tier_for(descriptors: int, *, width: int, kind: Kind, memory_mb: float) -> Engine:
    """Choose the inverted file if it fits into a memory limit, megabytes (10^6 bytes), else signatures.

    Binary descriptors have no signatures: for them it is always the inverted file.
    """
    fits = bytes_in_memory(descriptors, width=width, kind=kind) <= memory_mb * 1e6
    return "ivf" if fits or kind == "binary" else "vlad"
