"""Panoramas: what their XMP says (Google's Photo Sphere), and the views that are cut out of them."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import piexif
from numpy.typing import NDArray

from webapp.files.atomic import storage_error, write_bytes
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.files.photos.photo import PhotoFacts, read_file
from webapp.settings import PhotoLimits

_GPANO = re.compile(rb'GPano:(\w+)\s*(?:=\s*["\']|>)\s*([^"\'<]+)')
_ASPECT, _TOLERANCE = 2.0, 0.01
_QUALITY = 92


@dataclass(frozen=True, slots=True)
class Panorama:
    """What a photo says of itself as a panorama.

    Attributes
    ----------
    is_marked : bool
        It has the XMP of an equirectangular panorama.
    is_whole : bool
        It is twice as wide as high, and was not cropped.
    heading_deg : float or None
        Where its middle looks.
    """

    is_marked: bool
    is_whole: bool
    heading_deg: float | None


def read_panorama(content: bytes, size: tuple[int, int]) -> Panorama:
    """Read what a photo says of itself as a panorama.

    Parameters
    ----------
    size : (int, int)
        Width and height of the upright photo, pixels.
    """
    tags = {
        name.decode(): value.decode("utf-8", "replace").strip() for name, value in _GPANO.findall(content)
    }
    width, height = size
    is_whole = abs(width / height - _ASPECT) <= _TOLERANCE * _ASPECT
    full, shown = tags.get("FullPanoWidthPixels"), tags.get("CroppedAreaImageWidthPixels")
    if full is not None and shown is not None and full != shown:
        is_whole = False
    marked = tags.get("ProjectionType", "").lower() == "equirectangular"
    return Panorama(marked, is_whole, _number(tags.get("PoseHeadingDegrees")))


def is_panorama(path: Path, facts: PhotoFacts, *, limits: PhotoLimits) -> bool:
    """Check whether a photo says that it is a panorama, and is a whole one.

    Raises
    ------
    PhotoError
        It cannot be read.
    """
    size = facts.width, facts.height
    if abs(size[0] / size[1] - _ASPECT) > _TOLERANCE * _ASPECT:  # most photos need not be read for this
        return False
    found = read_panorama(read_file(path, limits=limits), size)
    return found.is_marked and found.is_whole


def _number(text: str | None) -> float | None:
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    return value % 360.0 if math.isfinite(value) else None


def write_view(path: Path, pixels: NDArray[np.uint8], *, tags: CameraTags) -> None:
    """Write a view as a JPEG.

    Raises
    ------
    StorageError
    """
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    out = io.BytesIO()
    piexif.insert(exif_bytes(tags), data, out)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, out.getvalue())
    except OSError as error:
        raise storage_error(error, where=str(path)) from error
