"""Affine transformations of pixels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel

Affine = tuple[float, float, float, float, float, float]
"""Rows of a 2 x 3 matrix, one after the other."""

_FLATTEST = 1e-9
"""Least area of the image of a pixel."""

_ON_A_LINE = 1e-9


def is_affine(values: Affine) -> bool:
    """Return whether a transformation is finite and has an inverse."""
    a, b, _, d, e, _ = values
    return all(map(math.isfinite, values)) and abs(a * e - b * d) > _FLATTEST


def apply_affine(affine: Affine, at: MapPixel) -> MapPixel:
    a, b, c, d, e, f = affine
    return MapPixel(a * at.x + b * at.y + c, d * at.x + e * at.y + f)


def compose(after: Affine, before: Affine) -> Affine:
    """Return the transformation that applies `before`, then `after`."""
    second, first = (np.vstack([np.reshape(one, (2, 3)), [0.0, 0.0, 1.0]]) for one in (after, before))
    a, b, c, d, e, f = (second @ first)[:2].ravel().tolist()
    return (a, b, c, d, e, f)


def affine_through(before: NDArray[np.float64], after: NDArray[np.float64]) -> Affine | None:
    """Fit a transformation by least squares; None if the points are on one line, or not finite.

    Args:
        before, after: (n, 2) float64. At least three points, and their images.
    """
    if not (np.isfinite(before).all() and np.isfinite(after).all()):
        return None
    rows = np.column_stack([before, np.ones(len(before))])
    found, _, rank, _ = np.linalg.lstsq(rows, after, rcond=_ON_A_LINE)
    a, b, c, d, e, f = found.T.ravel().tolist()
    return (a, b, c, d, e, f) if rank == 3 and is_affine((a, b, c, d, e, f)) else None
