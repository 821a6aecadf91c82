"""The input of every export, a map and its files, and its output, a download."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from webapp.core.boxes import BlurBox
from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.model import Experience, Map
from webapp.errors import MapError, MissingPart, NotFound, PhotoError, UsageError
from webapp.files.decode import Pixels
from webapp.files.maps.folder import photo_path, read_map
from webapp.files.photos.photo import preview_path, read_blurred, read_upright
from webapp.files.satellite.raster import opened_raster, reduced
from webapp.settings import PhotoLimits, Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import as_map
from webapp.tasks.maps.pictures import boxes_in_exports

_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Source:
    map: Map
    cfg: Path  # The map file; photos are relative to its folder
    title: str  # Display name
    name: str  # File name of the downloads, without extension: ASCII letters, digits, `-` and `_`
    # Returns the current boxes to blur in a photo, by its id: it may be blurred while the export is made.
    boxes: Callable[[int], Sequence[BlurBox]]
    unplaced: tuple[str, ...] = ()  # Paths of the photos in the tray

    def georeference(self) -> Georeference:
        """Return the georeference.

        Raises:
            UsageError: There is none, and this export needs one.
        """
        if self.map.georeference is None:
            raise UsageError(
                "this map has no georeference yet",
                hint="set its georeference on the page of the satellite image, or export .cfg, zip or HTML",
            )
        return self.map.georeference


@dataclass(frozen=True, slots=True)
class Download:
    name: str  # Safe in HTTP headers and on all file systems
    media_type: str
    pieces: Iterator[bytes]  # Its content in chunks, generated on demand


def of_library(library: Library, map_id: int) -> Source:
    """Read a map of the library from the database.

    Raises:
        NotFound: The map does not exist.
        UsageError: It has no satellite image yet.
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("map not found")
        map_ = as_map(session, record)
        slug, title = record.slug, record.name
        photos = [photo for photo in maps.photos(session, record) if not photo.removed]
        unplaced = tuple(photo.path for photo in photos if photo.x_px is None)
    if map_ is None:
        raise UsageError(
            "the map has no satellite image yet: there is nothing to export",
            hint="upload a satellite image, or start from a blank plan",
        )

    def boxes(photo_id: int) -> tuple[BlurBox, ...]:
        return boxes_in_exports(library, map_id, photo_id=photo_id)

    return Source(map_, library.cfg(slug), title, plain_name(slug), boxes, unplaced)


def of_folder(cfg: Path, *, title: str | None = None) -> Source:
    """Read the map of any `.cfg` file."""
    title = title or cfg.resolve().parent.name
    map_ = read_map(cfg)
    blurred = {e.id: e.blurred for e in map_.experiences}
    return Source(map_, cfg, title, plain_name(title), blurred.__getitem__)


def plain_name(text: str) -> str:
    """Make a file name without extension from any text."""
    ascii_ = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return _NOT_PLAIN.sub("-", ascii_)[:80].strip("-") or "map"


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
