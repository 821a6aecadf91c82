"""Makes thumbnails of a map's photos for exports; re-encoded, so that they contain no EXIF."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from webapp.core.mapmodel.model import Experience
from webapp.errors import MapError, MissingPart, NotFound, PhotoError
from webapp.files.decode import Pixels
from webapp.files.maps.folder import photo_path
from webapp.files.photos.photo import preview_path, read_blurred, read_upright
from webapp.files.satellite.raster import opened_raster, reduced
from webapp.settings import PhotoLimits, Settings
from webapp.tasks.exchange.export_source import Source

_QUALITY = 80


def thumbnail(source: Source, experience: Experience, *, side: int, limits: PhotoLimits) -> bytes | None:
    """Make a thumbnail of a photo, from its preview if there is one.

    Args:
        side: Maximum length of the longer side, pixels.

    Returns:
        JPEG without metadata; None if the photo is missing, unreadable, or was removed meanwhile.
    """
    cfg, id = source.cfg, experience.id
    try:
        blurred = source.boxes(id)
        preview = preview_path(cfg.parent, id, kind="thumb" if side <= 256 else "preview", blurred=blurred)
        if preview.exists():
            return encode_picture(read_upright(preview, limits=limits, max_side=side))
        pixels = read_blurred(photo_path(cfg, experience.photo), blurred, limits=limits, max_side=side)
    except (MapError, NotFound, PhotoError, MissingPart):
        return None
    return encode_picture(pixels)


def satellite_picture(cfg: Path, path: str, *, side: int, settings: Settings) -> Pixels | None:
    """Read the satellite image, scaled down to at most `side` pixels.

    Returns:
        (h, w, 3) uint8 or None: Blue, green, red; None if the image is missing or unreadable.
    """
    try:
        file = photo_path(cfg, path)
        with opened_raster(file, limits=settings.satellite) as raster:
            return np.ascontiguousarray(reduced(raster, side)[:, :, ::-1])
    except (MapError, PhotoError, MissingPart):
        return None


def encode_picture(pixels: Pixels, suffix: str = ".jpg") -> bytes:
    """Encode a picture as `.jpg` or `.webp`, without metadata."""
    kind = cv2.IMWRITE_JPEG_QUALITY if suffix == ".jpg" else cv2.IMWRITE_WEBP_QUALITY
    done, data = cv2.imencode(suffix, pixels, [kind, _QUALITY])
    assert done, "pictures of at most a few thousand pixels can always be encoded"
    return np.asarray(data).tobytes()
