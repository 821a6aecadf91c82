"""Detects photos with nothing to recognise: nearly uniform, black, or with too few keypoints."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features

FEWEST_KEYPOINTS = 8
"""With fewer, no relative pose can be verified, and any photo of the map matches as well as another."""

FEW_KEYPOINTS = 30
"""With fewer, photos of the map that look alike do so by chance: only matches that agree are evidence."""

_SMALL_SIDE_PX = 64
"""Contrast is measured on the photo reduced to this longer side, so that noise averages out."""

_LEAST_CONTRAST = 0.5
"""Standard deviation of grey values (0 to 255) on the reduced photo below which it is uniform. A street in a
sixtieth of the light still has about 1, noise alone less than 0.4."""


def why_blank(gray: NDArray[np.uint8], features: Features) -> str:
    """Return why there is nothing to recognise in a photo; empty if there may be something.

    Args:
        gray: (h, w) uint8
        features: Its keypoints.
    """
    if _contrast(gray) < _LEAST_CONTRAST:
        return "the photo is nearly uniform"
    return why_too_few(features) if len(features) < FEWEST_KEYPOINTS else ""


def why_too_few(features: Features) -> str:
    """Return how few keypoints there are."""
    count = len(features)
    return "no keypoints" if not count else f"only {count} keypoint{'s' if count > 1 else ''}"


def _contrast(gray: NDArray[np.uint8]) -> float:
    height, width = gray.shape
    shrunk = max(1.0, max(height, width) / _SMALL_SIDE_PX)
    size = max(1, round(width / shrunk)), max(1, round(height / shrunk))
    small = cv2.resize(gray.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return float(np.std(small))
