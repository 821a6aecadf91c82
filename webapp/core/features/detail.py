"""Detects photos without fine detail: enlarged parts of photos (digital zoom), or blurred ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
