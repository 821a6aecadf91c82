"""The features of many photos, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features


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
