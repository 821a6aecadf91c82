"""Fields of view of photos, guessed where unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.types import Segment

GUESSED_FOV_DEG = 65.0
"""Field of view along the longer side if nothing is known: between a webcam (60) and a telephone (70)."""


def fields_of_view(
    known: Sequence[float | None],
    segments: Sequence[Segment],
    *,
    photo_of_entry: NDArray[np.int64],
    given: float | None,
) -> NDArray[np.float64]:
    """Determine the field of view of each photo: from the map, from its EXIF, as given, or guessed.

    Args:
        known: As stored in the map.
        photo_of_entry: (e,) int64. As in `IndexedMap`.
    """
    fov = np.array([math.nan if one is None else one for one in known])
    exif = np.concatenate([s.fov_deg for s in segments])
    size = np.concatenate([s.photo_size for s in segments])
    for entry, photo in enumerate(photo_of_entry):
        if photo >= 0 and math.isnan(fov[photo]):
            width, height = size[entry]
            guess = given or guessed_fov_deg(int(width), int(height))
            fov[photo] = guess if math.isnan(exif[entry]) else exif[entry]
    return fov


def guessed_fov_deg(width: int, height: int) -> float:
    """Guess the horizontal field of view of a photo from its aspect ratio alone."""
    focal = max(width, height) / 2.0 / math.tan(math.radians(GUESSED_FOV_DEG) / 2.0)
    return math.degrees(2.0 * math.atan(width / 2.0 / focal))


def cropped_fov_deg(fov_deg: float, share: float) -> float:
    """Return the field of view of the middle of a photo that is this share of it."""
    return math.degrees(2.0 * math.atan(share * math.tan(math.radians(fov_deg) / 2.0)))
