"""Opens the files of map tiles that tile services are: on this server, or remote ones, read in parts."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from webapp.core.geo.tilegrid import TILE_PX, Tile, tile_metres
from webapp.errors import ExpMapError, InputError, UsageError
from webapp.extras import extra
from webapp.files.satellite.tile_archive import TileArchive, opened_pmtiles, opened_tiles
from webapp.net.ranges import RangeFile
from webapp.net.tiles import TileService
from webapp.settings import RemoteSettings

_PMTILES = b"PMTiles\x03"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PLANE = "EPSG:3857"
_NAME = "remote.tif"
"""What GDAL takes the file for; there are no others next to it."""

_LARGEST_BLOCK = 4096
"""Pixels of a side of a tile of a TIFF."""

_LARGEST_SIDE = 1 << 20
"""Pixels of a side of a tile of the map, before it is scaled down."""


@contextmanager
def opened_archive(service: TileService, *, cache: Path, settings: RemoteSettings) -> Iterator[TileArchive]:
    """Open the file of a tile service.

    Args:
        cache: Folder for parts of remote files.

    Raises:
        UsageError: The file is a remote one, and these are switched off.
        InputError, StorageError, MissingPart: As `opened_tiles`, and `RangeFile`; also when a tile is read.
    """
    if service.remote is None:
        assert service.file is not None, "services of other kinds have no file"
        with opened_tiles(service.file) as archive:
            yield archive
        return
    if settings.enabled == "no":
        raise UsageError(
            "remote files of map tiles are switched off",
            where=service.name,
            hint="the operator of the server can allow them: remote.enabled",
        )
    with RangeFile(service.remote, cache=cache, settings=settings) as file:
        head = file.part(0, 16)
        if head.startswith(_PMTILES):
            yield opened_pmtiles(file.part, name=service.name)
        elif head.startswith(_TIFF):
            with _opened_tiff(file, name=service.name) as archive:
                yield archive
        else:
            raise InputError(
                "this is neither PMTiles of version 3 nor TIFF",
                where=service.name,
                hint="expmap connect basemaps writes both",
            )


@contextmanager
def _opened_tiff(file: RangeFile, *, name: str) -> Iterator[TileArchive]:
    with extra("geotiff"):
        import rasterio
        from rasterio.errors import RasterioError
    reported = _Reported(file)
    try:
        with (
            rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR", GDAL_PAM_ENABLED="NO"),
            rasterio.open(_NAME, driver="GTiff", opener=reported.open) as dataset,
        ):
            _check(dataset, name)
            yield _Tiff(dataset, reported)
    except RasterioError as error:
        raise reported.error or InputError(
            f"the image cannot be read: {str(error)[:200]}", where=name, hint="check it with gdalinfo"
        ) from error


def _check(dataset: Any, name: str) -> None:
    """Refuse images of which no tiles can be made from few parts."""
    problems = {
        "it is not tiled": not dataset.profile.get("tiled"),
        "it has no coordinate system": dataset.crs is None,
        "its values are not bytes": set(dataset.dtypes) != {"uint8"},
        "it has neither one, three nor four bands": dataset.count not in (1, 3, 4),
        "its tiles are too large": max(dataset.block_shapes[0]) > _LARGEST_BLOCK,
    }
    for message, holds in problems.items():
        if holds:
            raise InputError(
                f"{message}, as cloud-optimised GeoTIFFs of photos are",
                where=name,
                hint="write it anew: expmap connect basemaps, or gdal_translate -of COG",
            )


class _Reported:
    """Opens a file for GDAL, which takes an error for the end of the file: it is kept, to be raised later."""

    def __init__(self, file: RangeFile) -> None:
        self.file = file
        self.error: ExpMapError | None = None

    def open(self, path: str, mode: str = "rb") -> _View:
        if path not in (_NAME, "test") or mode != "rb":  # rasterio tries an opener with "test"
            raise FileNotFoundError(path)
        return _View(self)


class _View(io.RawIOBase):
    """A reader with a position of its own, which leaves the file open when it is closed."""

    def __init__(self, reported: _Reported) -> None:
        super().__init__()
        self._reported, self._at = reported, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._reported.file.size}[whence]
        self._at = max(0, base + offset)
        return self._at

    def readinto(self, buffer: Any) -> int:
        try:
            data = self._reported.file.part(self._at, len(buffer))
        except ExpMapError as error:
            self._reported.error = error
            return 0
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)


class _Tiff:
    """Tiles of a cloud-optimised GeoTIFF in any coordinate system, from its overviews where they suffice."""

    def __init__(self, dataset: Any, reported: _Reported) -> None:
        with extra("geotiff"):
            from rasterio.vrt import WarpedVRT

        self._dataset, self._reported = dataset, reported
        with WarpedVRT(dataset, crs=_PLANE) as whole:
            self._pixel_m = whole.transform.a

    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        with extra("geotiff"):
            from rasterio import Affine
            from rasterio.enums import ColorInterp, Resampling
            from rasterio.errors import RasterioError
            from rasterio.vrt import WarpedVRT

        west, south, east, north = tile_metres(Tile(x, y), zoom)
        # at the image's own resolution: only then does GDAL use its overviews for a coarser tile
        side = min(max(round((east - west) / self._pixel_m), TILE_PX), _LARGEST_SIDE)
        options = {
            "crs": _PLANE,
            "transform": Affine((east - west) / side, 0.0, west, 0.0, (south - north) / side, north),
            "width": side,
            "height": side,
            "resampling": Resampling.bilinear,
            "add_alpha": ColorInterp.alpha not in self._dataset.colorinterp,
        }
        try:
            with WarpedVRT(self._dataset, **options) as warped:
                bands = warped.read(out_shape=(warped.count, TILE_PX, TILE_PX))
        except RasterioError as error:
            if self._reported.error is None:
                raise InputError(
                    f"a tile cannot be read: {str(error)[:200]}", where=f"{zoom}/{x}/{y}"
                ) from error
        if self._reported.error is not None:
            raise self._reported.error
        if not bands[-1].any():
            return None
        pixels = np.moveaxis(bands, 0, -1)
        if pixels.shape[2] == 2:  # grey
            pixels = pixels[:, :, [0, 0, 0, 1]]
        written = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(pixels[:, :, :4]), "RGBA").save(written, "PNG")
        return written.getvalue()
