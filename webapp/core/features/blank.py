"""Detects photos with nothing to recognise, and those without fine detail."""

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
    """
    if _contrast(gray) < _LEAST_CONTRAST:
        return "the photo is nearly uniform"
    return why_too_few(features) if len(features) < FEWEST_KEYPOINTS else ""


def why_too_few(features: Features) -> str:
    count = len(features)
    return "no keypoints" if not count else f"only {count} keypoint{'s' if count > 1 else ''}"


def _contrast(gray: NDArray[np.uint8]) -> float:
    height, width = gray.shape
    shrunk = max(1.0, max(height, width) / _SMALL_SIDE_PX)
    size = max(1, round(width / shrunk)), max(1, round(height / shrunk))
    small = cv2.resize(gray.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return float(np.std(small))


_SIDE_PX = 512
"""Longest sides of the middle of the photo that is examined."""

_COARSE, _FINE = (0.3, 0.5), (0.7, 0.9)
"""Bands of spatial frequencies that are compared, shares of the highest frequency that pixels can show."""

_LEAST_DECADES = -1.6
"""Power of the fine band over that of the coarse one, decades, below which there is no fine detail. Photos of
eight maps, by day and night, have -0.2 to -1.7, those enlarged to twice their size -1.5 to -2.9."""


def lacks_fine_detail(gray: NDArray[np.uint8]) -> bool:
    """Check whether a (h, w) photo has much less detail than its pixels could show."""
    height, width = gray.shape
    top, left = max(0, (height - _SIDE_PX) // 2), max(0, (width - _SIDE_PX) // 2)
    middle = gray[top : top + _SIDE_PX, left : left + _SIDE_PX].astype(np.float32)
    rows, columns = middle.shape
    middle = (middle - middle.mean()) * np.outer(np.hanning(rows), np.hanning(columns))
    power = np.abs(np.fft.rfft2(middle)) ** 2
    frequency = 2.0 * np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    coarse, fine = (power[(frequency >= low) & (frequency < high)] for low, high in (_COARSE, _FINE))
    if not coarse.any() or not fine.any():  # a tiny or uniform photo
        return False
    return bool(np.log10(fine.mean() / coarse.mean()) < _LEAST_DECADES)
