"""Opens image files of known formats: limits of size, a check of completeness, 8-bit pixels."""

from __future__ import annotations

import io
import math
import mmap
import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np
import pillow_heif
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from webapp.errors import PhotoError
from webapp.settings import PhotoLimits


class ImageFormat(NamedTuple):
    """A format of images that are read; it is recognised by content and not by the file's suffix."""

    media_types: tuple[str, ...]
    suffixes: tuple[str, ...]  # in lower case; the first is that of stored files
    is_photo: bool = True  # whether files in a folder with these suffixes count as photos


IMAGE_FORMATS: Mapping[str, ImageFormat] = {
    "JPEG": ImageFormat(("image/jpeg",), (".jpg", ".jpeg", ".jpe")),
    "PNG": ImageFormat(("image/png",), (".png",)),
    "HEIF": ImageFormat(("image/heic", "image/heif"), (".heic", ".heif")),
    "AVIF": ImageFormat(("image/avif",), (".avif",)),
    "WEBP": ImageFormat(("image/webp",), (".webp",)),
    "TIFF": ImageFormat(("image/tiff",), (".tif", ".tiff")),
    "BMP": ImageFormat(("image/bmp",), (".bmp",)),
    "JPEG2000": ImageFormat(("image/jp2",), (".jp2",)),
    "GIF": ImageFormat(("image/gif",), (".gif",), is_photo=False),
}
"""By their names in Pillow. What pages accept, and the suffixes of stored photos, follow from it."""

FORMATS = tuple(IMAGE_FORMATS)

DAMAGED = (SyntaxError, ValueError, TypeError, KeyError, IndexError, EOFError, RuntimeError, struct.error)
"""Exceptions of Pillow for damaged files and metadata, besides OSError; fuzzing found no others."""

Pixels = NDArray[np.uint8]

PHOTO_SUFFIXES = frozenset(s for entry in IMAGE_FORMATS.values() if entry.is_photo for s in entry.suffixes)
"""Suffixes, in lower case, of the files in a folder that count as photos."""

_MANY_IN_ONE = "MPO"
"""What Pillow calls a JPEG with several images."""

_ANY_SIZE = PhotoLimits(max_mb=math.inf, max_megapixels=math.inf)
_SMALL = (64, 64)
_MAX_SIDE = 65_535
"""Pixels, the limit of JPEG: longer images are not photos, and scaling them takes too much memory."""

_COSTLY_FORMATS, _COSTLY = frozenset({"WEBP", "JPEG2000"}), 3
"""Their decoders take 14 and 17 bytes of memory per pixel, others 5: they may have 3 times fewer pixels."""

_MAX_SCANS = 32
"""Of a JPEG: a few bytes can be a scan of the whole photo. Cameras write 1, usual programs 10 to 12."""

_START_OF_SCAN, _END_OF_IMAGE = b"\xda", b"\xd9"
_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])", re.DOTALL)
"""Any marker but those within compressed data, where 0xff is followed by 0x00 or a restart marker's code."""

_SMALL_RANGE = 8192
"""Of 65536 values: photos that use less would be nearly black, or nearly of one grey."""

_BULK = (0.001, 0.999)
"""Quantiles of the values in use; single pixels may be hot or dead."""

_ROWS = 256
_SAMPLED = 200_000
"""Pixels by which the range of values is found."""

MOST_OF_16_BITS = 30_000_000
"""Pixels up to which dark colours are stretched: that takes 6 more bytes for each."""

_OF_16_BITS = "file of 16 bits per colour"
"""In `info` of an opened image: Pillow forgets this, and the file, when it decodes."""


_COLOURS_LEFT_OUT = {"LAB": "CIELab", "HSV": "HSV"}
"""Modes of Pillow that cannot be converted, and what they are."""

_JPEG_XL = (b"\xff\n", b"\0\0\0\x0cJXL \r\n\x87\n")
"""The first bytes of its files."""

_TILE = (322, 323)
"""Tags of TIFF: width and height of a tile, pixels."""

_LARGEST_TILE = 4096 * 4096
"""Pixels of a tile that a small image may have, too."""


@contextmanager
def open_image(source: Path | bytes, *, limits: PhotoLimits) -> Iterator[Image.Image]:
    """Open an image: its header is read, but nothing is decoded yet.

    Errors caused by damage, also those in the caller's block, become a `PhotoError`.

    Yields:
        The first frame.

    Raises:
        PhotoError: The file is missing, not an image of a known format, damaged, truncated, or exceeds the
            limits.
    """
    pillow_heif.register_heif_opener()
    where = str(source) if isinstance(source, Path) else None
    with warnings.catch_warnings():
        # ignored: warnings about size, which `limits` replaces, and about odd metadata
        warnings.simplefilter("ignore")
        try:
            check_bytes(source, limits)
            file = io.BytesIO(source) if isinstance(source, bytes) else source
            with Image.open(file, formats=FORMATS) as image:
                _check_pixels(image, limits)
                _check_side(image)
                _check_colours(image)
                _check_tiles(image)
                if image.format in ("JPEG", _MANY_IN_ONE):
                    check_scans(source)
                if not image.mode.startswith("I") and any(";16" in str(tile) for tile in image.tile):
                    image.info[_OF_16_BITS] = source
                yield image
        except PhotoError as error:
            raise PhotoError(error.message, where=where, hint=error.hint) from error
        except UnidentifiedImageError as error:
            if is_jpeg_xl(source):
                raise jpeg_xl_error(where) from error
            raise PhotoError("it is not an image of a known format", where=where) from error
        except Image.DecompressionBombError as error:
            raise PhotoError("it has far too many pixels", where=where) from error
        except OSError as error:
            if error.strerror is None:  # of the decoder, not of the disk
                raise PhotoError(
                    "the file is damaged, or its end is missing", where=where, hint="copy or send it again"
                ) from error
            raise PhotoError(f"it cannot be read: {error.strerror}", where=where) from error
        except DAMAGED as error:
            raise PhotoError(f"it is damaged: {error}", where=where) from error


def stored_suffix(name: str) -> str:
    """Return the suffix of a stored file, without its dot, by the name of its format in Pillow."""
    return IMAGE_FORMATS["JPEG" if name == _MANY_IN_ONE else name].suffixes[0].removeprefix(".")


def is_jpeg_xl(source: Path | bytes) -> bool:
    """Return whether a file, or content, is JPEG XL, which is not read."""
    if isinstance(source, bytes):
        return source.startswith(_JPEG_XL)
    with source.open("rb") as file:
        return file.read(max(map(len, _JPEG_XL))).startswith(_JPEG_XL)


def jpeg_xl_error(where: str | None = None) -> PhotoError:
    return PhotoError(
        "it is JPEG XL, which is not supported yet", where=where, hint="convert it to JPEG or PNG"
    )


def _check_colours(image: Image.Image) -> None:
    if image.mode in _COLOURS_LEFT_OUT:
        raise unsupported_colours(_COLOURS_LEFT_OUT[image.mode])


def unsupported_colours(name: str) -> PhotoError:
    """Return the error about an image whose colours cannot be converted."""
    return PhotoError(f"it has unsupported colours ({name})", hint="save it in RGB, as JPEG or PNG")


def contrast_note(source: Path | bytes, *, limits: PhotoLimits) -> str | None:
    """Return a sentence if `decode` stretches the contrast of an image; None if not.

    Raises PhotoError.
    """
    with open_image(source, limits=limits) as image:
        values: NDArray[np.generic] | None = _dark_colours(image)
        if values is None and not (image.mode.startswith("I;16") or image.mode == "I"):
            return None
        image.load()
        found = _small_range(np.asarray(image) if values is None else values)
    if found is None:
        return None
    low, high = found
    return f"its contrast was stretched: nearly all of its 16-bit values are from {low} to {high}"


def decode(image: Image.Image, mode: Literal["L", "RGB"]) -> Pixels:
    """Decode an opened image to 8 bits per channel, as stored (EXIF orientation not applied).

    Of 16 bits the upper eight are kept, but values that use a small part of them, as from sensors of 10 or 14
    bits, are stretched. Floats are scaled by their range of values, alpha is dropped.

    Args:
        mode: "L" or "RGB"

    Returns:
        (h, w) or (h, w, 3) uint8
    """
    if mode == "L" and image.format in ("JPEG", _MANY_IN_ONE) and image.mode == "RGB":
        # decode the stored luma itself rather than convert it to colours and back to grey
        image.draft("L", image.size)
    colours = _dark_colours(image)
    stretched = None if colours is None else _small_range(colours)
    if colours is not None and stretched is not None:
        pixels = _stretched(colours.reshape(image.height, -1), *stretched).reshape(colours.shape)
        del colours  # twice as large
        order = cv2.COLOR_BGR2GRAY if mode == "L" else cv2.COLOR_BGR2RGB
        return np.asarray(cv2.cvtColor(pixels, order), np.uint8)
    del colours
    image.load()
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        image = Image.fromarray(_eight_bits(np.asarray(image), sixteen=image.mode != "F"))
    return _converted(image, mode)


def _dark_colours(image: Image.Image) -> NDArray[np.uint16] | None:
    """Return the colours of an opened image of 16 bits per colour if it may use a small range of them.

    Pillow keeps the upper eight bits of colours, which leave nothing of them.

    Returns:
        (h, w, 3): blue, green and red.
    """
    source = image.info.get(_OF_16_BITS)
    if source is None or image.width * image.height > MOST_OF_16_BITS:
        return None
    image.load()
    bands = len(image.getbands()) - image.mode.endswith("A")
    counts = np.reshape(image.histogram(), (-1, 256))[:bands].sum(axis=0)
    low, high = np.searchsorted(np.cumsum(counts), np.multiply(_BULK, counts.sum())).tolist()
    if 256 * (high - low) >= _SMALL_RANGE:
        return None
    data = source if isinstance(source, bytes) else source.read_bytes()
    kind = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    values: NDArray[np.generic] | None = cv2.imdecode(np.frombuffer(data, np.uint8), kind)
    if values is None or values.dtype != np.uint16 or values.shape[:2] != (image.height, image.width):
        return None
    return np.asarray(values, np.uint16)


def _converted(image: Image.Image, mode: Literal["L", "RGB"]) -> Pixels:
    """Convert an image, a few rows at a time: for a whole image Pillow would make two more copies."""
    size = (image.height, image.width)
    pixels = np.empty(size if mode == "L" else (*size, 3), dtype=np.uint8)
    for top in range(0, image.height, _ROWS):
        strip = image.crop((0, top, image.width, min(top + _ROWS, image.height)))
        pixels[top : top + _ROWS] = np.asarray(strip if strip.mode == mode else strip.convert(mode))
    return pixels


def _eight_bits(values: NDArray[np.generic], *, sixteen: bool) -> Pixels:
    """Scale (h, w) values to 8 bits, a few rows at a time, to save memory."""
    strips = [values[top : top + _ROWS] for top in range(0, len(values), _ROWS)]
    if sixteen and _fits_16_bits(values):
        found = _small_range(values)
        if found is not None:
            return _stretched(values, *found)
        return np.concatenate([(strip.astype(np.uint16) >> 8).astype(np.uint8) for strip in strips])
    low = min(0.0, *(float(_finite(strip).min(initial=0.0)) for strip in strips))
    high = max(0.0, *(float(_finite(strip).max(initial=0.0)) for strip in strips))
    factor = 255.0 / (high - low or 1.0)
    return np.concatenate([((_finite(strip) - low) * factor).astype(np.uint8) for strip in strips])


def _fits_16_bits(values: NDArray[np.generic]) -> bool:
    return values.dtype == np.uint16 or bool(values.max(initial=0) < 65536 and values.min(initial=0) >= 0)


def _stretched(values: NDArray[np.generic], black: int, white: int) -> Pixels:
    """Stretch (h, w) 16-bit values, a few rows at a time, to save memory."""
    pixels = np.empty(values.shape, np.uint8)
    for top in range(0, len(values), _ROWS):
        above = cv2.subtract(values[top : top + _ROWS].astype(np.uint16, copy=False), float(black))
        pixels[top : top + _ROWS] = cv2.convertScaleAbs(above, alpha=255.0 / (white - black))
    return pixels


def _small_range(values: NDArray[np.generic]) -> tuple[int, int] | None:
    """Return the range of nearly all 16-bit values of (h, w) or (h, w, 3); None if it is wide, or empty."""
    if not _fits_16_bits(values):
        return None
    pixels = values.reshape(values.shape[0] * values.shape[1], -1)
    sample = pixels[:: max(1, len(pixels) // _SAMPLED)]
    below = np.cumsum(np.bincount(sample.ravel(), minlength=65536))
    low, high = np.searchsorted(below, np.multiply(_BULK, below[-1])).tolist()
    return (low, high) if 0 < high - low < _SMALL_RANGE else None


def _finite(values: NDArray[np.generic]) -> NDArray[np.float64]:
    return np.nan_to_num(values.astype(np.float64), posinf=0.0, neginf=0.0)


def check_bytes(source: Path | bytes, limits: PhotoLimits) -> None:
    """Reject a missing, empty or too large file (or content) without reading it. Raises PhotoError."""
    if isinstance(source, Path) and not source.is_file():
        if source.is_dir():
            raise PhotoError("it is a folder and not a photo", hint="name photos, not their folder")
        missing = "it is not a file" if source.exists() else "file not found"
        raise PhotoError(missing, hint="check its path")
    size = source.stat().st_size if isinstance(source, Path) else len(source)
    if size == 0:
        raise PhotoError("it is empty", hint="copy it from the camera again")
    if size > limits.max_mb * 1e6:
        raise PhotoError(
            f"it has {size / 1e6:.0f} MB, more than the limit of {limits.max_mb:g}",
            hint="scale it down, or raise the limit",
        )


def _check_pixels(image: Image.Image, limits: PhotoLimits) -> None:
    megapixels = image.width * image.height / 1e6
    most = limits.max_megapixels / (_COSTLY if image.format in _COSTLY_FORMATS else 1)
    if megapixels > most:
        of_format = f" for {image.format}" if image.format in _COSTLY_FORMATS else ""
        raise PhotoError(
            f"it has {megapixels:.0f} megapixels, more than the limit of {most:g}{of_format}",
            hint="scale it down, or raise the limit",
        )


def _check_side(image: Image.Image) -> None:
    if max(image.size) > _MAX_SIDE:
        raise PhotoError(f"it is {max(image.size)} pixels long, more than {_MAX_SIDE}", hint="cut out a part")


def _check_tiles(image: Image.Image) -> None:
    """Reject a TIFF of tiles far larger than itself: each is decompressed as a whole."""
    width, height = (getattr(image, "tag_v2", {}).get(tag, 0) for tag in _TILE)
    if not (isinstance(width, int) and isinstance(height, int)):
        raise PhotoError("its tiles have no valid size")
    if width * height > max(_LARGEST_TILE, 2 * image.width * image.height):
        raise PhotoError(f"it has {image.width} x {image.height} pixels in tiles of {width} x {height}")


def check_scans(source: Path | bytes) -> None:
    """Reject a JPEG with very many scans: a few hundred kilobytes could take minutes to decode.

    Raises PhotoError.
    """
    if isinstance(source, bytes):
        refused = has_too_many_scans(source)
    else:
        with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            refused = has_too_many_scans(data)
    if refused:
        raise PhotoError("it is compressed in an unusual way", hint="open it in an editor and save it again")


def has_too_many_scans(data: bytes | mmap.mmap) -> bool:
    """Return whether decoding a JPEG takes more than `_MAX_SCANS` passes over it.

    Args:
        data: The file; bytes after the end of its first image are ignored.
    """
    scans, place = 0, 0
    while found := _MARKER.search(data, place):
        if found[1] == _END_OF_IMAGE:
            return False
        scans += found[1] == _START_OF_SCAN
        if scans > _MAX_SCANS:
            return True
        end = found.end()
        is_start_of_image = found.start() == 0
        place = end if is_start_of_image else end + int.from_bytes(data[end : end + 2], "big")
    return False


def image_size(source: Path | bytes) -> tuple[int, int]:
    """Read width and height in pixels from the header, as stored (orientation not applied)."""
    with open_image(source, limits=_ANY_SIZE) as image:
        return image.size


def check_decodes(path: Path, *, limits: PhotoLimits) -> None:
    """Check that a photo is complete, by decoding it at the smallest size that its format allows."""
    with open_image(path, limits=limits) as image:
        image.draft("L", _SMALL)
        image.load()
