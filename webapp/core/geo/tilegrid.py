"""The grid of web map tiles: pixels of the whole Earth in web Mercator; the area of an image.

At zoom z the square of web Mercator (EPSG:3857) has 256 * 2^z pixels a side, (0, 0) at its north-western
corner; a tile has 256 x 256 of them. A cut-out of whole pixels is an affine image of that plane: its
georeference is exact, and nothing is resampled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.crs import plane_from_latlon
from webapp.core.geo.fit import check_positions
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame, centre_of
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


def tile_metres(tile: Tile, zoom: int) -> tuple[float, float, float, float]:
    """Return west, south, east and north of a tile, in metres of web Mercator."""
    side = 2.0 * _HALF_M / (1 << zoom)
    return (
        tile.x * side - _HALF_M,
        _HALF_M - (tile.y + 1) * side,
        (tile.x + 1) * side - _HALF_M,
        _HALF_M - tile.y * side,
    )


def tile_box(tile: Tile, zoom: int) -> GeoBox:
    """Return the area of a tile."""
    west, south, east, north = (metres / _HALF_M * math.pi for metres in tile_metres(tile, zoom))
    lats = (math.atan(math.sinh(y)) for y in (north, south))
    return GeoBox(*map(math.degrees, (*lats, west, east)))


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


Array = NDArray[np.float64]

MARGIN = 0.15
"""Margin on each side, as a fraction of the longer side: the outermost photos show what is around them."""

_LEAST_MARGIN_M = 30.0
_OUTLIER_DISTANCES = 6.0
"""A photo farther from the middle than this multiple of the median distance is an outlier."""

_NEVER_OUTLIER_M = 300.0


@dataclass(frozen=True, slots=True)
class PhotoArea:
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
