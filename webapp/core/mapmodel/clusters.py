"""Clusters nearby positions: a placement that answers "which part of the park?"."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from webapp.core.geo.types import MapPixel
from webapp.errors import UsageError


def gather(positions: Mapping[int, MapPixel], *, radius_px: float) -> dict[int, MapPixel]:
    """Move each photo to the centre of its cluster.

    The photo with the most others within the radius forms a cluster with them, then the next of those left.
    No photo moves farther than twice the radius, however dense the map. The order of photos has no influence.

    Args:
        positions: By id.
        radius_px: Above 0, map pixels.

    Returns:
        The mean of each cluster, by id; inside the hull of the positions.
    """
    if not (math.isfinite(radius_px) and radius_px > 0):
        raise UsageError(f"{radius_px} is not a radius", hint="give a positive number of pixels")
    ids = sorted(positions)
    xy = np.array([positions[id] for id in ids], np.float64).reshape(-1, 2)
    crowd = [int((np.hypot(*(xy - at).T) <= radius_px).sum()) for at in xy]
    left = np.ones(len(ids), bool)
    gathered: dict[int, MapPixel] = {}
    for leader in sorted(range(len(ids)), key=lambda i: (-crowd[i], *xy[i].tolist())):
        if not left[leader]:
            continue
        members = np.flatnonzero(left & (np.hypot(*(xy - xy[leader]).T) <= radius_px))
        left[members] = False
        x, y = xy[members].mean(axis=0).tolist()
        gathered |= {ids[member]: MapPixel(x, y) for member in members}
    return dict(sorted(gathered.items()))
