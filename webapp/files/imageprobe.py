"""Asks an image file for its size, or whether it can be decoded, at the least cost."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pillow_heif
from PIL import Image, UnidentifiedImageError

from webapp.errors import PhotoError
from webapp.settings import PhotoLimits

PHOTO_SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jpe", ".png", ".heic", ".heif", ".webp", ".tif", ".tiff", ".bmp", ".avif", ".jp2"}
)
"""Endings, in small letters, by which a file in a folder is taken for a photo."""

_SMALL = (64, 64)


def image_size(path: Path) -> tuple[int, int]:
    """Read width and height in pixels from the header, as stored (orientation not applied).

    Raises
    ------
    PhotoError
        The file is missing or no image.
    """
    with _opened(path) as image:
        return image.size


def check_decodes(path: Path, *, limits: PhotoLimits) -> None:
    """Decode a photo, as small as its format allows, to see whether it is complete.

    Raises
    ------
    PhotoError
        It is missing, no image, cut off, damaged, or larger than the limits.
    """
    with _opened(path) as image:
        megabytes = path.stat().st_size / 1e6
        if megabytes > limits.max_mb:
            raise PhotoError(f"it has {megabytes:.1f} MB, more than {limits.max_mb:g}", where=str(path))
        megapixels = image.width * image.height / 1e6
        if megapixels > limits.max_megapixels:
            message = f"it has {megapixels:.1f} megapixels, more than {limits.max_megapixels:g}"
            raise PhotoError(message, where=str(path))
        image.draft("L", _SMALL)
        image.load()


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    pillow_heif.register_heif_opener()
    with warnings.catch_warnings():
        # odd metadata and large images are warned about; neither makes an image unreadable here
        warnings.simplefilter("ignore")
        try:
            with Image.open(path) as image:
                yield image
        except UnidentifiedImageError as error:
            raise PhotoError("it is not an image of a known format", where=str(path)) from error
        except Image.DecompressionBombError as error:
            raise PhotoError("it has far too many pixels", where=str(path)) from error
        except OSError as error:
            raise PhotoError(error.strerror or str(error), where=str(path)) from error
        except (SyntaxError, ValueError, EOFError, TypeError, KeyError, IndexError) as error:
            # what Pillow's decoders raise for damaged files, besides OSError
            raise PhotoError(f"it is damaged ({error})", where=str(path)) from error
