"""The only module that knows the half pixel between the two ways to count pixels.

"Corner": (0, 0) is the outer corner of the first pixel (map pixels). "Centre": (0, 0) is the centre of the
first pixel (OpenCV keypoints, world files).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_HALF = 0.5


def corner_from_centre(points: ArrayLike) -> NDArray[np.float64]:
    """Map pixels of points counted from pixel centres; any shape, float64."""
    return np.asarray(points, dtype=np.float64) + _HALF


def centre_from_corner(points: ArrayLike) -> NDArray[np.float64]:
    """Points counted from pixel centres of map pixels; any shape, float64."""
    return np.asarray(points, dtype=np.float64) - _HALF


def homography_for_corners(homography_for_centres: ArrayLike) -> NDArray[np.float64]:
    """Make a homography that takes map pixels of one that takes points counted from pixel centres.

    Parameters
    ----------
    homography_for_centres : (3, 3) float64

    Returns
    -------
    (3, 3) float64
    """
    shift = np.array([[1.0, 0.0, -_HALF], [0.0, 1.0, -_HALF], [0.0, 0.0, 1.0]])
    return np.asarray(np.asarray(homography_for_centres) @ shift, dtype=np.float64)
