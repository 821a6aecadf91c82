"""Interface and results of search engines, and the choice of one by the memory limit of an index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Engine, Features, Kind


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


@dataclass(frozen=True, slots=True, eq=False)
class PhotoEntry:
    """One photo's features, with hash and field of view of its file."""

    content: str  # SHA-256 of the file, hexadecimal
    fov_deg: float  # Horizontal field of view of the upright photo from EXIF; NaN if unknown
    features: Features


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Features of many photos; the arrays may be memory-mapped."""

    content: list[str]  # SHA-256 of each of the p photo files
    first: NDArray[np.int64]  # (p + 1,) int64. Rows of photo i are `first[i]` to `first[i + 1]`.
    # `xy`, `size`, `angle`, `descriptors`: As in `Features`, for all rows.
    xy: NDArray[np.float32]
    size: NDArray[np.float32]
    angle: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    photo_size: NDArray[np.int32]  # (p, 2) int32. Width and height of the upright photos.
    fov_deg: NDArray[np.float64]  # (p,) float64. From EXIF; NaN if unknown.

    def entry(self, photo: int) -> PhotoEntry:
        """Return one photo, by its number in the segment."""
        rows = slice(int(self.first[photo]), int(self.first[photo + 1]))
        width, height = self.photo_size[photo]
        features = Features(
            xy=self.xy[rows],
            size=self.size[rows],
            angle=self.angle[rows],
            descriptors=self.descriptors[rows],
            photo_size=(int(width), int(height)),
        )
        return PhotoEntry(self.content[photo], float(self.fov_deg[photo]), features)
