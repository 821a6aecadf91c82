"""Asks an image file for its size, or whether it can be decoded, at the least cost."""

from __future__ import annotations

import math
from pathlib import Path

from webapp.files.decode import opened
from webapp.settings import PhotoLimits

PHOTO_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".png", ".heic", ".heif", ".webp", ".tif", ".tiff", ".bmp", ".avif", ".jp2"}
)
"""Endings, in small letters, by which a file in a folder is taken for a photo."""

_ANY_SIZE = PhotoLimits(max_mb=math.inf, max_megapixels=math.inf)
_SMALL = (64, 64)


def image_size(path: Path) -> tuple[int, int]:
    """Read width and height in pixels from the header, as stored (orientation not applied).

    Raises
    ------
    PhotoError
        The file is missing or no image.
    """
    with opened(path, limits=_ANY_SIZE) as image:
        return image.size


def check_decodes(path: Path, *, limits: PhotoLimits) -> None:
    """Decode a photo, as small as its format allows, to see whether it is complete.

    Raises
    ------
    PhotoError
        It is missing, no image, cut off, damaged, or larger than the limits.
    """
    with opened(path, limits=limits) as image:
        image.draft("L", _SMALL)
        image.load()
