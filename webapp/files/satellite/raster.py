"""Reads large images strip by strip, resamples them, and writes those of a map.

With rasterio (the extra `geotiff`), memory does not depend on their size. Without it, TIFFs cannot be read,
and other images are decoded as a whole.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.floors import FloorImage
from webapp.errors import PhotoError
from webapp.extras import extra, is_installed
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.decode import (
    check_scans,
    decode,
    is_jpeg_xl,
    jpeg_xl_error,
    open_image,
    unsupported_colours,
)
from webapp.files.part_file import move_in
from webapp.settings import PhotoLimits, SatelliteLimits

if TYPE_CHECKING:
    from rasterio.io import DatasetReader


Kind = Literal["PNG", "JPEG", "GTiff"]
Pixels = NDArray[np.uint8]

STRIP_ROWS = 256
_MAGIC: tuple[tuple[bytes, Kind], ...] = (
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"II*\x00", "GTiff"),
    (b"MM\x00*", "GTiff"),
    (b"II+\x00", "GTiff"),
    (b"MM\x00+", "GTiff"),
)
_ALONE = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_PAM_ENABLED": "NO",
    "PROJ_NETWORK": "OFF",
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",
    "GDAL_CACHEMAX": 64,
}
"""GDAL options: only the file itself is read; truncation is an error (with the whole-image optimisation, half
a PNG would pass as complete); blocks are cached in 64 MB."""
_MAX_BLOCK_BYTES = 600_000_000
_MAX_SIDE = 100_000
_LARGEST = 1e38
"""Limit of values, so that a difference of two is still finite in float32."""

_SMALLEST_RANGE = 1e-6
"""Minimum range from black to white, relative to the value: more than the precision of float32."""

_SAMPLE_PX = 1000


class Raster(Protocol):
    kind: Kind  # "PNG", "JPEG" or "GTiff". By content.
    # `width`, `height`: Pixels, as stored.
    width: int
    height: int
    lossy: bool  # Whether its pixels have been through JPEG
    georeferenced: bool  # Whether the file places its pixels, as stored, on the Earth

    def strips(self, rows: int = STRIP_ROWS) -> Iterator[Pixels]:
        """Read the image from top to bottom.

        Args:
            rows: Of each strip; the last one may have fewer.

        Yields:
            (n, width, 3) uint8: Red, green, blue; transparent pixels and those without data are white.
        """


class _DecodedRaster:
    """A PNG or JPEG in memory."""

    def __init__(self, image: Image.Image, kind: Kind) -> None:
        self.kind, self.lossy, self.georeferenced = kind, kind == "JPEG", False
        self.width, self.height = image.size
        self._image = image

    def strips(self, rows: int = STRIP_ROWS) -> Iterator[Pixels]:
        """Read the image from top to bottom; see `Raster.strips`."""
        self._image.load()
        transparent = self._image.has_transparency_data
        for top in range(0, self.height, rows):
            strip = self._image.crop((0, top, self.width, min(top + rows, self.height)))
            if transparent:
                rgba = np.asarray(strip.convert("RGBA"))
                yield on_white(rgba[:, :, :3], rgba[:, :, 3])
            else:
                yield decode(strip, "RGB")


class _GdalRaster:
    """An image that GDAL reads block by block."""

    def __init__(self, dataset: DatasetReader, kind: Kind) -> None:
        self.kind = kind
        self.width, self.height = int(dataset.width), int(dataset.height)
        self.georeferenced = not dataset.transform.is_identity or bool(dataset.gcps[0])
        self._dataset = dataset
        colours = dataset.count >= 3
        self._bands = [1, 2, 3] if colours else [1]
        # a single band may have a palette
        self._palette = None if colours else _palette(dataset)
        self._masked = "all_valid" not in {flag.name for flag in dataset.mask_flag_enums[0]}
        compression = dataset.compression
        self.lossy = kind == "JPEG" or (compression is not None and compression.name == "jpeg")
        self._range = None if self._palette is not None else _range(dataset, self._bands, kind)

    def strips(self, rows: int = STRIP_ROWS) -> Iterator[Pixels]:
        """Read the image from top to bottom; see `Raster.strips`."""
        for top in range(0, self.height, rows):
            yield self._colours(((top, min(top + rows, self.height)), (0, self.width)))

    def _colours(self, window: tuple[tuple[int, int], tuple[int, int]]) -> Pixels:
        values = self._dataset.read(self._bands, window=window)
        if self._range is not None:
            low, high = self._range
            within = np.nan_to_num(np.clip(values, low, high), nan=low).astype(np.float32)
            values = np.clip((within - low) * (255.0 / (high - low)), 0.0, 255.0).astype(np.uint8)
        if self._palette is not None:
            rgb = self._palette[values[0]]
        elif len(values) == 1:
            rgb = np.repeat(values[0][:, :, None], 3, axis=2)
        else:
            rgb = np.ascontiguousarray(values.transpose(1, 2, 0))
        if self._masked:
            return on_white(rgb, self._dataset.dataset_mask(window=window))
        return np.asarray(rgb, dtype=np.uint8)


def on_white(rgb: Pixels, opacity: Pixels) -> Pixels:
    """Blend (h, w, 3) colours with white by their (h, w) opacity."""
    share = opacity.astype(np.uint16)[:, :, None]
    return np.asarray((rgb * share + 255 * (255 - share) + 127) // 255, dtype=np.uint8)


@contextmanager
def opened_raster(path: Path, *, limits: SatelliteLimits) -> Iterator[Raster]:
    """Open a PNG, JPEG or TIFF image, recognised by content and not by name.

    Errors caused by damage, also those in the caller's block, become a `PhotoError`.

    Raises:
        PhotoError: The file is missing, has another format, is damaged or truncated, or exceeds the limits.
        MissingPart: It is a TIFF, and rasterio is not installed.
    """
    kind = _kind(path, limits)
    if kind == "JPEG":
        check_scans(path)
    read = _with_gdal if kind == "GTiff" or is_installed("geotiff") else _decoded
    with read(path, kind, limits=limits) as raster:
        yield raster


@contextmanager
def _with_gdal(path: Path, kind: Kind, *, limits: SatelliteLimits) -> Iterator[Raster]:
    with extra("geotiff"):
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    with rasterio.Env(**_ALONE), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with rasterio.open(path, driver=kind) as dataset:
                _check_size(dataset.width, dataset.height, limits)
                _check_blocks(dataset)
                if dataset.photometric is not None and dataset.photometric.name == "cielab":
                    raise unsupported_colours("CIELab")
                yield _GdalRaster(dataset, kind)
        except RasterioError as error:
            raise _damaged(error.__cause__ or error) from error


@contextmanager
def _decoded(path: Path, kind: Kind, *, limits: SatelliteLimits) -> Iterator[Raster]:
    pixels = PhotoLimits(max_mb=limits.max_mb, max_megapixels=math.inf)
    try:
        with open_image(path, limits=pixels) as image:
            _check_size(*image.size, limits)
            yield _DecodedRaster(image, kind)
    except PhotoError as error:
        if error.__cause__ is None:
            raise
        raise _damaged(error.message) from error


def _damaged(reason: object) -> PhotoError:
    return PhotoError(
        f"the image is damaged, truncated or of an unsupported kind: {reason}",
        hint="open it in an image editor and save it again as PNG",
    )


def is_georeferenced_tiff(path: Path, *, limits: SatelliteLimits) -> bool:
    """Return whether a file is a TIFF that places its pixels on the Earth; False if it cannot be read."""
    if image_kind(path) != "GTiff" or not is_installed("geotiff"):
        return False
    try:
        with opened_raster(path, limits=limits) as raster:
            return raster.georeferenced
    except PhotoError:  # its reader reports it
        return False


def reduced(raster: Raster, max_side: int) -> Pixels:
    """Scale an image down by averaging squares of pixels, reading it once.

    Returns:
        (h, w, 3) uint8: Red, green, blue; the longer side has at most `max_side` pixels.
    """
    factor = math.ceil(max(raster.width, raster.height) / max_side)
    width = math.ceil(raster.width / factor)
    parts = [
        cv2.resize(strip, (width, math.ceil(len(strip) / factor)), interpolation=cv2.INTER_AREA)
        for strip in raster.strips(factor * math.ceil(STRIP_ROWS / factor))
    ]
    return np.asarray(np.concatenate(parts), dtype=np.uint8)


def image_kind(path: Path) -> Kind | None:
    """Return the kind of an image by its first bytes; None if it is none of those that are shown."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise PhotoError(f"the image cannot be read: {error.strerror}") from error
    return next((kind for magic, kind in _MAGIC if head.startswith(magic)), None)


def _kind(path: Path, limits: SatelliteLimits) -> Kind:
    kind = image_kind(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise PhotoError(f"the image cannot be read: {error.strerror}") from error
    if size == 0:
        raise PhotoError("the file is empty", hint="copy it again")
    if size > limits.max_mb * 1e6:
        raise PhotoError(
            f"the image has {size / 1e6:.0f} MB, more than the limit of {limits.max_mb:g}",
            hint="scale it down, or cut out the area of the map",
        )
    if kind is None and is_jpeg_xl(path):
        raise jpeg_xl_error()
    if kind is None:
        raise PhotoError("this is not a PNG, JPEG or TIFF image", hint="save it as one of these")
    return kind


def _check_size(width: int, height: int, limits: SatelliteLimits) -> None:
    if max(width, height) > _MAX_SIDE:
        raise PhotoError(
            f"the image is {max(width, height)} pixels long, more than {_MAX_SIDE}",
            hint="cut out the area of the map",
        )
    megapixels = width * height / 1e6
    if megapixels > limits.max_megapixels:
        raise PhotoError(
            f"the image has {megapixels:.0f} megapixels, more than the limit of {limits.max_megapixels:g}",
            hint="scale it down, or cut out the area of the map",
        )


def _check_blocks(dataset: DatasetReader) -> None:
    if dataset.dtypes[0].startswith("complex"):
        raise PhotoError("the image holds complex numbers", hint="save it as PNG")
    rows, columns = dataset.block_shapes[0]
    block = rows * columns * dataset.count * np.dtype(dataset.dtypes[0]).itemsize
    if block > _MAX_BLOCK_BYTES:
        raise PhotoError(
            "the TIFF is too large to be read at once, and has no smaller tiles",
            hint="save it with tiles (gdal_translate -co TILED=YES)",
        )


def _palette(dataset: DatasetReader) -> Pixels | None:
    try:
        colours = dataset.colormap(1)
    except ValueError:  # there is none
        return None
    table = np.zeros((256, 3), np.uint8)
    for index, rgba in colours.items():
        if 0 <= index < 256:
            table[index] = rgba[:3]
    return table


def _range(dataset: DatasetReader, bands: list[int], kind: Kind) -> tuple[float, float] | None:
    """Choose the values of black and white; None where they are 0 and 255.

    Of fewer than 8 bits, as in plans, all values are used; of more, those of a PNG; else black and white are
    percentiles 1 and 99 of the values.
    """
    if dataset.dtypes[0] == "uint8":
        bits = int(dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 8))
        return None if bits >= 8 else (0.0, 2.0**bits - 1.0)
    if kind == "PNG":
        return 0.0, 65535.0
    factor = max(1, math.ceil(max(dataset.width, dataset.height) / _SAMPLE_PX))
    shape = (len(bands), math.ceil(dataset.height / factor), math.ceil(dataset.width / factor))
    values = dataset.read(bands, out_shape=shape, masked=True).astype(np.float64)
    finite = values.compressed()[np.isfinite(values.compressed())]
    if not len(finite):
        return 0.0, 1.0
    low, high = np.clip(np.percentile(finite, [1.0, 99.0]), -_LARGEST, _LARGEST).tolist()
    return low, max(high, low + max(1.0, abs(low) * _SMALLEST_RANGE))


QUALITY = 92
"""Of JPEG."""


def keep_file(source: Path, folder: Path) -> str:
    """Move a PNG or JPEG file into the map's folder, named by its hash, and return its name.

    Args:
        source: On the same disk.
    """
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0)
        suffix = ".png" if file.read(4) == b"\x89PNG" else ".jpg"
    name = f"satellite-{digest[:8]}{suffix}"
    move_in(source, folder / name)
    return name


def keep_pixels(pixels: NDArray[np.uint8], folder: Path, *, lossless: bool = True) -> str:
    """Write an image to the map's folder, named by its hash.

    Args:
        pixels: (h, w, 3) uint8. Blue, green, red.
        lossless: PNG, else JPEG.
    """
    if lossless:
        data = cv2.imencode(".png", pixels)[1].tobytes()
    else:
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    name = f"satellite-{hashlib.sha256(data).hexdigest()[:8]}{'.png' if lossless else '.jpg'}"
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / name, data)
    return name


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Distinguish a failing disk from a damaged image."""
    try:
        yield
    except OSError as error:
        raise storage_error(error, where=folder.name) from error


def warp_to_map(raster: Raster, image: FloorImage, *, size: tuple[int, int], side: int) -> Pixels:
    """Resample the image of a floor to cover the whole map.

    Args:
        size: Width and height of the map, map pixels.
        side: Maximum pixels of the longer side; fewer if the image has a lower resolution.

    Returns:
        (h, w, 4) uint8: Red, green, blue, opacity; transparent outside the image.
    """
    pixels = reduced(raster, side)
    a, b, c, d, e, f = image.map_from_image
    shrunk = raster.width / pixels.shape[1], raster.height / pixels.shape[0]
    map_from_pixel = np.array([[a * shrunk[0], b * shrunk[1], c], [d * shrunk[0], e * shrunk[1], f]])
    finest = 1.0 / math.sqrt(abs(float(np.linalg.det(map_from_pixel[:, :2]))))
    scale = min(side / max(size), finest)
    width, height = (max(1, round(length * scale)) for length in size)
    matrix = np.diag([width / size[0], height / size[1]]) @ map_from_pixel
    # the origin of OpenCV is the centre of the first pixel, that of a map its outer corner
    matrix[:, 2] += matrix[:, :2] @ (0.5, 0.5) - 0.5
    opaque = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
    return np.asarray(cv2.warpAffine(opaque, matrix, (width, height), flags=cv2.INTER_LINEAR), np.uint8)
