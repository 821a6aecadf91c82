"""The area that an image of the ground should cover, from the positions of photos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import LatLon

Array = NDArray[np.float64]

MARGIN = 0.15
"""Margin on each side, as a fraction of the longer side: the outermost photos show what is around them."""

_LEAST_MARGIN_M = 30.0
_OUTLIER_DISTANCES = 6.0
"""A photo farther from the middle than this multiple of the median distance is an outlier."""

_NEVER_OUTLIER_M = 300.0


@dataclass(frozen=True, slots=True)
class PhotoArea:
    """The surroundings of photos."""

    box: GeoBox  # Includes a margin
    # `inside`, `outside`: Number of photos in it, and of outliers far away.
    inside: int
    outside: int


def area_around(latlon: ArrayLike) -> PhotoArea:
    """Return a box around photos, robust to some wrong GPS positions.

    Args:
        latlon: (n, 2) float64. At least one position; degrees north, degrees east.
    """
    positions = np.asarray(latlon, dtype=np.float64).reshape(-1, 2)
    frame = LocalFrame(_most_central(positions))
    enu = frame.enu_from_latlon(positions)
    distances = np.hypot(enu[:, 0], enu[:, 1])
    usual = distances <= max(_OUTLIER_DISTANCES * float(np.median(distances)), _NEVER_OUTLIER_M)
    low, high = enu[usual].min(axis=0), enu[usual].max(axis=0)
    margin = max(MARGIN * float((high - low).max()), _LEAST_MARGIN_M)
    (west, south), (east, north) = (low - margin).tolist(), (high + margin).tolist()
    lat, lon = frame.latlon_from_enu([(west, north), (east, north), (east, south), (west, south)]).T
    box = GeoBox(float(lat.max()), float(lat.min()), *_span(lon, middle=frame.origin.lon))
    return PhotoArea(box, int(usual.sum()), int((~usual).sum()))


def _most_central(positions: Array) -> LatLon:
    """Find the position nearest to the median of all, which is robust to outliers."""
    enu = LocalFrame(centre_of(positions)).enu_from_latlon(positions)
    away = enu - np.median(enu, axis=0)
    lat, lon = positions[int(np.argmin(np.hypot(away[:, 0], away[:, 1])))]
    return LatLon(float(lat), float(lon))


def _span(lon: Array, *, middle: float) -> tuple[float, float]:
    """Return the westernmost and the easternmost longitude, also across the 180th meridian."""
    from_middle = (lon - middle + 180.0) % 360.0 - 180.0
    west, east = (float(lon[index(from_middle)]) for index in (np.argmin, np.argmax))
    return west, east
