"""The image of a map, resampled to the tiles of web maps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference, latlon_grid
from webapp.core.geo.tilegrid import MAX_ZOOM, TILE_PX, GeoBox, TileCut, cut_of
from webapp.core.geo.types import MapPixel
from webapp.errors import UsageError
from webapp.progress import Progress

Pixels = NDArray[np.uint8]

_GRID_PX = 16
"""Distance of the points in a tile that are transformed exactly; between them positions are interpolated."""

_COARSER = 1.1
"""How much larger than those of the image the pixels of the most detailed tiles may be."""


@dataclass(frozen=True, slots=True)
class MapTile:
    """A tile that shows a part of the image."""

    zoom: int
    # `x`, `y`: Column and row, from the north-western corner.
    x: int
    y: int
    pixels: Pixels  # (256, 256, 4): blue, green, red, opacity


class Tiling:
    """All tiles of an image.

    Args:
        image: (h, w, 3) uint8. Red, green, blue.
        zoom: The most detailed; None for the one nearest to the image's own resolution.

    Raises:
        UsageError: The image crosses the 180th meridian or lies beyond web Mercator.
        GeoreferenceError: Its corners have no position.
    """

    def __init__(self, image: Pixels, georeference: Georeference, *, zoom: int | None = None) -> None:
        height, width = image.shape[:2]
        self._image = np.dstack([image[:, :, ::-1], np.full((height, width), 255, np.uint8)])
        self._georeference = georeference
        self.box = _box(georeference, width=width, height=height)
        centre = georeference.metres_per_pixel(MapPixel(width / 2, height / 2))
        self.max_zoom = _zoom(self.box, centre) if zoom is None else zoom
        self.cut = cut_of(self.box, self.max_zoom)  # The pixels that the image covers at that zoom
        longer = max(self.cut.width, self.cut.height)
        self.min_zoom = max(0, self.max_zoom - math.ceil(math.log2(max(longer / TILE_PX, 1.0))))

    def tiles(self, progress: Progress) -> Iterator[MapTile]:
        """Yield the tiles of all zooms that are not empty.

        Args:
            progress: One step per most detailed tile.
        """
        progress.size(self.cut.tile_count)
        shift = self.max_zoom - self.min_zoom
        tops = dict.fromkeys((tile.x >> shift, tile.y >> shift) for tile, _, _ in self.cut.tiles())
        for x, y in tops:
            yield from self._below(self.min_zoom, x=x, y=y, progress=progress)

    def _below(self, zoom: int, *, x: int, y: int, progress: Progress) -> Iterator[MapTile]:
        """Yield the tiles inside one, and last the tile itself."""
        if zoom == self.max_zoom:
            progress.check()
            progress.advance()
            pixels = self._resampled(zoom, x=x, y=y)
        else:
            joined = np.zeros((2 * TILE_PX, 2 * TILE_PX, 4), np.uint8)
            for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
                column, row = 2 * x + right, 2 * y + down
                if not self._touches(zoom + 1, x=column, y=row):
                    continue
                for tile in self._below(zoom + 1, x=column, y=row, progress=progress):
                    yield tile
                    if tile.zoom == zoom + 1:
                        top, left = down * TILE_PX, right * TILE_PX
                        joined[top : top + TILE_PX, left : left + TILE_PX] = tile.pixels
            pixels = _half(joined)
        if pixels[:, :, 3].any():
            yield MapTile(zoom, x, y, pixels)

    def _touches(self, zoom: int, *, x: int, y: int) -> bool:
        cut, side = self.cut, TILE_PX << (self.max_zoom - zoom)
        across = x * side < cut.left + cut.width and cut.left < (x + 1) * side
        return across and y * side < cut.top + cut.height and cut.top < (y + 1) * side

    def _resampled(self, zoom: int, *, x: int, y: int) -> Pixels:
        grid = TileCut(zoom, x * TILE_PX, y * TILE_PX, TILE_PX, TILE_PX).georeference
        steps = np.arange(0, TILE_PX + 1, _GRID_PX, dtype=np.float64)
        points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        found = self._georeference.pixel_from_latlon(grid.latlon_from_pixel(points))
        found = found.reshape(len(steps), len(steps), 2)
        height, width = self._image.shape[:2]
        if not np.isfinite(found).all() or _outside(found, width=width, height=height):
            return np.zeros((TILE_PX, TILE_PX, 4), np.uint8)
        weights = _weights(len(steps))
        # the origin of OpenCV is the centre of the first pixel, that of a map its outer corner
        columns, rows = (
            (weights @ found[:, :, axis] @ weights.T - 0.5).astype(np.float32) for axis in (0, 1)
        )
        return np.asarray(cv2.remap(self._image, columns, rows, cv2.INTER_LINEAR), np.uint8)


def _box(georeference: Georeference, *, width: int, height: int) -> GeoBox:
    corners = [corner for corner in latlon_grid(georeference, (width, height)).latlon if corner is not None]
    (south, west), (north, east) = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
    if west < -180.0 or east > 180.0:
        raise UsageError("the image crosses the 180th meridian", hint="export the map as a zip instead")
    return GeoBox(north=north, south=south, west=west, east=east)


def _zoom(box: GeoBox, metres_per_pixel: float) -> int:
    fine = (z for z in range(MAX_ZOOM) if cut_of(box, z).metres_per_pixel <= _COARSER * metres_per_pixel)
    return next(fine, MAX_ZOOM)


def _outside(found: NDArray[np.float64], *, width: int, height: int) -> bool:
    (left, top), (right, bottom) = found.min(axis=(0, 1)).tolist(), found.max(axis=(0, 1)).tolist()
    return bool(right <= 0 or bottom <= 0 or left >= width or top >= height)


def _weights(count: int) -> NDArray[np.float64]:
    """Return the weights (256, count) that interpolate at pixel centres between points `_GRID_PX` apart."""
    at = (np.arange(TILE_PX) + 0.5) / _GRID_PX
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)[None, :]))


def _half(joined: Pixels) -> Pixels:
    """Shrink four tiles to one; transparent pixels do not darken their neighbours."""
    opacity = joined[:, :, 3:].astype(np.float32)
    weighted = np.dstack([joined[:, :, :3] * opacity, opacity])
    small = cv2.resize(weighted, (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA)
    colours = small[:, :, :3] / np.maximum(small[:, :, 3:], 1e-6)
    return np.asarray(np.rint(np.dstack([colours, small[:, :, 3]])), np.uint8)
