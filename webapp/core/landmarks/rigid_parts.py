"""Splits a reconstruction where its photos share too few points.

A part that is connected by a few points only, at a sharp turn or between similar facades, has an arbitrary
direction and scale: it becomes a submodel of its own, which is aligned with the map separately.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST_PHOTOS = 3
"""Least number of photos of a submodel."""

_LEAST_SHARED = 20
"""Least number of shared points that connect two photos rigidly."""


def rigid_parts(
    shared: NDArray[np.int32], *, frame: NDArray[np.int64] | None = None
) -> list[NDArray[np.int64]]:
    """Split photos into rigidly connected parts, the largest first; smaller ones are left out.

    Args:
        shared: (n, n) int32. Number of points that two photos share.
        frame: (n,) int64. Photos with the same frame, views of a panorama, are always connected and count as
            one photo. By default each photo has its own.
    """
    own = np.arange(len(shared)) if frame is None else frame
    strong = (shared >= _LEAST_SHARED) | (own[:, None] == own)
    part = np.full(len(shared), -1, np.int64)
    for seed in range(len(shared)):
        if part[seed] >= 0:
            continue
        inside = np.zeros(len(shared), np.bool_)
        inside[seed] = True
        border = inside
        while border.any():
            border = strong[border].any(0) & ~inside
            inside |= border
        part[inside] = seed
    parts = [np.flatnonzero(part == seed) for seed in np.unique(part)]
    enough = (p for p in parts if len(np.unique(own[p])) >= LEAST_PHOTOS)
    return sorted(enough, key=len, reverse=True)
