"""Writes files of tiles: MBTiles, PMTiles and cloud-optimised GeoTIFF."""

from __future__ import annotations

import io
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from webapp.connect.basemaps.tiling import MapTile, Pixels, Tiling
from webapp.core.geo.tilegrid import MERCATOR, TILE_PX
from webapp.extras import extra
from webapp.progress import Progress

_JPEG_QUALITY = 90


@dataclass(frozen=True, slots=True)
class Description:
    """What a file says of itself."""

    name: str
    attribution: str  # Empty if unknown
    lossy: bool  # Whether the image has been through JPEG: its tiles are JPEG, too, and white outside it


def write_mbtiles(path: Path, tiling: Tiling, *, about: Description, progress: Progress) -> None:
    """Write MBTiles 1.3."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE metadata (name TEXT, value TEXT);"
            "CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB);"
            "CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row);"
        )
        box = tiling.box
        metadata = {
            "name": about.name,
            "format": "jpg" if about.lossy else "png",
            "type": "overlay",
            "bounds": f"{box.west:.7f},{box.south:.7f},{box.east:.7f},{box.north:.7f}",
            "minzoom": str(tiling.min_zoom),
            "maxzoom": str(tiling.max_zoom),
            "attribution": about.attribution,
        }
        database.executemany("INSERT INTO metadata VALUES (?, ?)", metadata.items())
        database.executemany(
            "INSERT INTO tiles VALUES (?, ?, ?, ?)",
            (
                (tile.zoom, tile.x, (1 << tile.zoom) - 1 - tile.y, _encoded(tile, lossy=about.lossy))
                for tile in tiling.tiles(progress)
            ),
        )
        database.commit()


def write_pmtiles(path: Path, tiling: Tiling, *, about: Description, progress: Progress) -> None:
    """Write PMTiles 3. Raises MissingPart."""
    with extra("connect"):
        from pmtiles.tile import Compression, TileType, zxy_to_tileid
        from pmtiles.writer import Writer
    box = tiling.box
    header = {
        "tile_type": TileType.JPEG if about.lossy else TileType.PNG,
        "tile_compression": Compression.NONE,
        "min_lon_e7": round(box.west * 1e7),
        "min_lat_e7": round(box.south * 1e7),
        "max_lon_e7": round(box.east * 1e7),
        "max_lat_e7": round(box.north * 1e7),
        "center_zoom": tiling.min_zoom,
        "center_lon_e7": round((box.west + box.east) * 5e6),
        "center_lat_e7": round((box.south + box.north) * 5e6),
    }
    with path.open("wb") as file:
        writer = Writer(file)
        for tile in tiling.tiles(progress):
            writer.write_tile(zxy_to_tileid(tile.zoom, tile.x, tile.y), _encoded(tile, lossy=about.lossy))
        writer.finalize(header, {"name": about.name, "attribution": about.attribution, "type": "overlay"})


def write_cog(path: Path, tiling: Tiling, *, about: Description, progress: Progress) -> None:
    """Write a cloud-optimised GeoTIFF in web Mercator, with opacity. Raises MissingPart."""
    with extra("geotiff"):
        import rasterio
        from rasterio.shutil import copy
        from rasterio.transform import Affine
        from rasterio.windows import Window
    cut = tiling.cut
    a, b, c, d, e, f = cut.georeference.plane_from_pixel[:6]
    plain = path.with_suffix(".plain.tif")
    try:
        with rasterio.open(
            plain, "w", driver="GTiff", width=cut.width, height=cut.height, count=4, dtype="uint8",
            crs=MERCATOR, transform=Affine(a, b, c, d, e, f), tiled=True, photometric="RGB", ALPHA="YES",
        ) as written:  # fmt: skip
            written.update_tags(TITLE=about.name, COPYRIGHT=about.attribution)
            for tile in tiling.tiles(progress):
                if tile.zoom == tiling.max_zoom:
                    top, left = tile.y * TILE_PX - cut.top, tile.x * TILE_PX - cut.left
                    rows = slice(max(-top, 0), min(TILE_PX, cut.height - top))
                    columns = slice(max(-left, 0), min(TILE_PX, cut.width - left))
                    part = tile.pixels[rows, columns][:, :, [2, 1, 0, 3]].transpose(2, 0, 1)
                    window = Window(max(left, 0), max(top, 0), part.shape[2], part.shape[1])
                    written.write(part, window=window)
        copy(plain, path, driver="COG", COMPRESS="DEFLATE", PREDICTOR="YES", OVERVIEW_RESAMPLING="AVERAGE")
    finally:
        plain.unlink(missing_ok=True)


def _encoded(tile: MapTile, *, lossy: bool) -> bytes:
    made = Image.fromarray(
        _on_white(tile.pixels) if lossy else cv2.cvtColor(tile.pixels, cv2.COLOR_BGRA2RGBA)
    )
    buffer = io.BytesIO()
    made.save(buffer, "JPEG" if lossy else "PNG", quality=_JPEG_QUALITY)
    return buffer.getvalue()


def _on_white(pixels: Pixels) -> Pixels:
    opacity = pixels[:, :, 3:].astype(np.float32) / 255.0
    white = pixels[:, :, 2::-1] * opacity + 255.0 * (1.0 - opacity)
    return np.asarray(np.rint(white), np.uint8)
