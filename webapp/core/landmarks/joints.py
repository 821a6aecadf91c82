"""Cuts a model where too little holds it together.

What hangs on a few points, at a sharp turn or between facades that look alike, has any direction and scale:
it is a submodel of its own, which has to be laid on the map by itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST_PHOTOS = 3
"""Of a submodel; fewer say nothing of each other."""

_LEAST_SHARED = 20
"""Points that both of two photos see, which hold them together."""


def rigid_parts(
    shared: NDArray[np.int32], *, frame: NDArray[np.int64] | None = None
) -> list[NDArray[np.int64]]:
    """Split photos into parts that are held together, the largest first; those in none are left out.

    Parameters
    ----------
    shared : (n, n) int32
        Points that two photos both see.
    frame : (n,) int64, optional
        Photos of one frame hold together: views of a panorama, which count as one photo. By default each is
        one of its own.
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
