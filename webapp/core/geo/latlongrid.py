"""A georeference sampled on a grid, for programs that have no map projections of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference


@dataclass(frozen=True, slots=True)
class LatLonGrid:
    """Latitude and longitude of the corners of equal cells that cover a map image.

    Attributes
    ----------
    columns, rows : int
        Cells across and down; there is one corner more each way.
    latlon : tuple of (lat, lon) or None
        Degrees, row by row from the top-left corner of the image; None where there is no position. Longitudes
        go on beyond 180 where the image crosses that meridian, so that they can be interpolated.
    """

    columns: int
    rows: int
    latlon: tuple[tuple[float, float] | None, ...]


def latlon_grid(georeference: Georeference, size: tuple[int, int], *, cells: int = 16) -> LatLonGrid:
    """Sample a georeference.

    Interpolated linearly in a cell, a georeference without perspective is off by about an eighth of the
    squared cell over the Earth's radius: a centimetre for an image of 5 km.

    Parameters
    ----------
    size : tuple of (int, int)
        Width and height of the image, pixels.
    cells : int
        Along each side.
    """
    width, height = size
    x, y = np.meshgrid(np.linspace(0.0, width, cells + 1), np.linspace(0.0, height, cells + 1))
    latlon = georeference.latlon_from_pixel(np.column_stack([x.ravel(), y.ravel()]))
    known: NDArray[np.bool_] = np.asarray(np.isfinite(latlon).all(axis=1))
    latlon[:, 1] = _continuous(latlon[:, 1], known)
    return LatLonGrid(
        columns=cells,
        rows=cells,
        latlon=tuple(
            (float(lat), float(lon)) if ok else None for (lat, lon), ok in zip(latlon, known, strict=True)
        ),
    )


def _continuous(longitudes: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Bring all within half a turn of the first one that is known."""
    if not known.any():
        return longitudes
    first = longitudes[known][0]
    return np.asarray(first + (longitudes - first + 180.0) % 360.0 - 180.0, dtype=np.float64)
