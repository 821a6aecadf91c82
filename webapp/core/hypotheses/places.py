"""What counts as one place."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

RADIUS_OVER_SPACING = 2.0
_SHARE_OF_SIDE = 0.05


def spacing_px(position: NDArray[np.float64]) -> float | None:
    """Compute the median distance from each distinct position to the nearest other.

    Parameters
    ----------
    position : (p, 2) float64
        Map pixels.

    Returns
    -------
    float or None
        None when there are fewer than two distinct positions.
    """
    distinct = np.unique(position, axis=0).astype(np.float32)
    if len(distinct) < 2:
        return None
    trees = cv2.flann_Index(distinct, {"algorithm": 4})
    _, squared = trees.knnSearch(distinct, 2, params={"checks": -1})
    return float(np.median(np.sqrt(squared[:, 1])))


def place_radius_px(position: NDArray[np.float64], *, width: int, height: int) -> float:
    """Choose how far from the truth an answer may be and still name the right place.

    Parameters
    ----------
    position : (p, 2) float64
        Of the map's photos, map pixels.
    width, height : int
        Of the satellite image.

    Returns
    -------
    float
        Twice the median distance between neighbouring distinct positions; with fewer than two positions
        a twentieth of the image's longer side.
    """
    spacing = spacing_px(position)
    if spacing is None:
        return _SHARE_OF_SIDE * max(width, height)
    return RADIUS_OVER_SPACING * spacing
