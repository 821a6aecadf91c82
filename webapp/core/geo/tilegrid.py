"""The grid of web map tiles: pixels of the whole Earth in web Mercator, at each zoom.

At zoom z the square of web Mercator (EPSG:3857) has 256 * 2^z pixels a side, (0, 0) at its north-western
corner; a tile has 256 x 256 of them. A cut-out of whole pixels is an affine image of that plane: its
georeference is exact, and nothing is resampled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from webapp.core.geo.crs import plane_from_latlon
from webapp.core.geo.fit import check_positions
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError

TILE_PX = 256
MAX_ZOOM = 24
MERCATOR = "EPSG:3857"
MAX_LATITUDE = 85.05112877980659
"""Latitude limit of the square of web Mercator, degrees."""

_MERCATOR_FROM_180 = "+proj=webmerc +datum=WGS84 +lon_0=180 +units=m +no_defs"
"""Web Mercator centred on the 180th meridian, for an area across it."""

_HALF_M = math.pi * 6378137.0
"""Half a side of the square, in metres of the projection."""


class GeoBox(NamedTuple):
    """An area between two parallels and two meridians, degrees; west > east across the 180th meridian."""

    north: float
    south: float
    west: float
    east: float


class Tile(NamedTuple):
    """Column and row of a tile at some zoom, from the north-western corner."""

    x: int
    y: int


@dataclass(frozen=True, slots=True)
class TileCut:
    """A rectangle of whole pixels at a zoom."""

    zoom: int
    # `left`, `top`: Its outer corner in the pixel grid of the whole Earth; `left` is less than the grid's
    # width.
    left: int
    top: int
    # `width`, `height`: Pixels.
    width: int
    height: int

    @property
    def world_px(self) -> int:
        """Width of the grid of the whole Earth, pixels."""
        return TILE_PX << self.zoom

    @property
    def tile_count(self) -> int:
        """Number of tiles that it touches."""
        columns, rows = self._ranges()
        return len(columns) * len(rows)

    @property
    def georeference(self) -> Georeference:
        """Exact georeference of its pixels."""
        scale = 2.0 * _HALF_M / self.world_px
        across = self.left + self.width > self.world_px
        west = self.left * scale - (2.0 * _HALF_M if across else _HALF_M)
        matrix = (scale, 0.0, west, 0.0, -scale, _HALF_M - self.top * scale, 0.0, 0.0, 1.0)
        return Georeference(_MERCATOR_FROM_180 if across else MERCATOR, matrix, "tiles")

    @property
    def metres_per_pixel(self) -> float:
        """Size of a pixel on the ground at its centre."""
        return self.georeference.metres_per_pixel(MapPixel(self.width / 2, self.height / 2))

    def tiles(self) -> Iterator[tuple[Tile, int, int]]:
        """Yield each tile with its left and top edges relative to the rectangle, pixels, row by row."""
        columns, rows = self._ranges()
        for y in rows:
            for x in columns:
                tile = Tile(x % (1 << self.zoom), y)
                yield tile, x * TILE_PX - self.left, y * TILE_PX - self.top

    def _ranges(self) -> tuple[range, range]:
        right, bottom = self.left + self.width - 1, self.top + self.height - 1
        return (
            range(self.left // TILE_PX, right // TILE_PX + 1),
            range(self.top // TILE_PX, bottom // TILE_PX + 1),
        )


def cut_of(box: GeoBox, zoom: int) -> TileCut:
    """Cut an area out of the grid, with its edges at the nearest pixel boundaries.

    Args:
        zoom: 0 to 24.

    Returns:
        At least one pixel wide and high.

    Raises:
        GeoreferenceError: The area is empty, invalid or beyond the square of web Mercator, or the zoom level
            does not exist.
    """
    if not 0 <= zoom <= MAX_ZOOM:
        raise GeoreferenceError(f"zoom {zoom} does not exist", hint=f"choose 0 to {MAX_ZOOM}")
    check_positions([LatLon(box.north, box.west), LatLon(box.south, box.east)])
    if max(abs(box.north), abs(box.south)) > MAX_LATITUDE:
        raise GeoreferenceError(
            "map tiles end at 85 degrees north and south", hint="choose an area closer to the equator"
        )
    if box.south >= box.north or box.west == box.east:
        raise GeoreferenceError(
            "the area is empty: its south edge is not below its north edge, or west and east are the same",
            hint="draw a rectangle",
        )
    corners = [(box.north, box.west), (box.south, box.east)]
    pixels_a_metre = (TILE_PX << zoom) / (2.0 * _HALF_M)
    (west, north), (east, south) = plane_from_latlon(MERCATOR, corners).tolist()
    if box.west > box.east:
        east += 2.0 * _HALF_M
    left, right = (math.floor((x + _HALF_M) * pixels_a_metre + 0.5) for x in (west, east))
    top, bottom = (math.floor((_HALF_M - y) * pixels_a_metre + 0.5) for y in (north, south))
    return TileCut(zoom, left, top, width=max(right - left, 1), height=max(bottom - top, 1))
