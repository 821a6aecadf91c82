"""Tiles of a large image for display, at all zoom levels, made in one pass from top to bottom.

At the largest zoom a tile shows 256 x 256 pixels of the image; at each smaller zoom twice as many per side;
at zoom 0 one tile shows everything. A pixel at zoom z is exactly 2^(largest - z) pixels of the image wide and
high, even if the size of the image is odd.
"""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import cv2
import numpy as np

from webapp.files.atomic import storage_error
from webapp.files.satellite.raster import Pixels, Raster
from webapp.progress import Progress

TILE_PX = 256
_JPEG_QUALITY = 85
_WEBP_QUALITY = 85


def max_zoom(*, width: int, height: int) -> int:
    """Return the zoom at which a pixel of a tile is one pixel of the image."""
    return max(0, math.ceil(math.log2(max(width, height) / TILE_PX)))


def write_pyramid(raster: Raster, folder: Path, *, progress: Progress) -> None:
    """Write the tiles of an image as `folder/z/x_y.jpg`, those beyond its edge as partly transparent `.webp`.

    Args:
        folder: Appears once it is complete; an interrupted run starts again. If it exists, nothing is done.
        progress: One step per strip of the image.
    """
    if folder.is_dir():
        return
    unfinished = folder.with_name(f"{folder.name}.part")
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        level = _Level(unfinished, max_zoom(width=raster.width, height=raster.height))
        progress.size(math.ceil(raster.height / TILE_PX))
        for strip in raster.strips(TILE_PX):
            progress.check()
            level.take(strip)
            progress.advance()
        level.finish()
        unfinished.rename(folder)
    except OSError as error:
        raise storage_error(error, where=folder.name) from error


class _Level:
    """One zoom level: collects rows, writes them as a row of tiles, and passes them on at half the size."""

    def __init__(self, folder: Path, zoom: int) -> None:
        self._folder = folder / f"{zoom}"
        self._folder.mkdir()
        self._smaller = _Level(folder, zoom - 1) if zoom else None
        self._rows: list[Pixels] = []
        self._y = 0

    def take(self, rows: Pixels) -> None:
        """Take the next rows: an even number, except the last ones, and at most the height of a tile."""
        self._rows.append(rows)
        if sum(len(part) for part in self._rows) >= TILE_PX:
            self._write()

    def finish(self) -> None:
        """Write the remaining rows."""
        if self._rows:
            self._write()
        if self._smaller:
            self._smaller.finish()

    def _write(self) -> None:
        strip = np.concatenate(self._rows)
        self._rows = []
        for x in range(math.ceil(strip.shape[1] / TILE_PX)):
            tile = strip[:, x * TILE_PX : (x + 1) * TILE_PX]
            suffix, data = _encode(tile)
            (self._folder / f"{x}_{self._y}{suffix}").write_bytes(data)
        self._y += 1
        if self._smaller:
            self._smaller.take(_half(strip))


def _half(strip: Pixels) -> Pixels:
    height, width = strip.shape[:2]
    even = np.pad(strip, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    size = (even.shape[1] // 2, even.shape[0] // 2)
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _encode(tile: Pixels) -> tuple[str, bytes]:
    if tile.shape[:2] == (TILE_PX, TILE_PX):
        bgr = cv2.cvtColor(tile, cv2.COLOR_RGB2BGR)
        return ".jpg", cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    # beyond the edge of the image; browsers draw every tile as a full square
    square = np.zeros((TILE_PX, TILE_PX, 4), np.uint8)
    square[: tile.shape[0], : tile.shape[1]] = cv2.cvtColor(tile, cv2.COLOR_RGB2BGRA)
    return ".webp", cv2.imencode(".webp", square, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])[1].tobytes()
