"""Versions of a satellite image for browsers: itself or a lighter copy, a thumbnail, tiles of a large one.

Copies are in the map's `derived/satellite/KEY/` and can be made again; the key changes with the file.
"""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path
from threading import BoundedSemaphore

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from webapp.core.geo.floors import Floor
from webapp.errors import NotFound
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.contents import facts_of, remove
from webapp.files.decode import decode, open_image
from webapp.files.maps.folder import photo_path
from webapp.files.satellite.pyramid import write_pyramid
from webapp.files.satellite.raster import opened_raster, reduced, warp_to_map
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX
from webapp.threads import permit

PREVIEW_PX = 2048
THUMBNAIL_PX = 480
_QUALITY = 85
_LIGHT_BYTES = 300_000
"""PNG files up to this size are sent unchanged."""
_READING = BoundedSemaphore(1)
"""Large images are read one after the other: each keeps a core busy for seconds."""

_MIME = (
    (b"\x89PNG\r\n\x1a\n", "image/png"),
    (b"\xff\xd8\xff", "image/jpeg"),
    (b"GIF8", "image/gif"),
    (b"BM", "image/bmp"),
    (b"RIFF", "image/webp"),
)
"""Formats that every browser shows, by their first bytes."""


@dataclass(frozen=True, slots=True)
class DisplayFile:
    path: Path
    mime: str
    key: str  # Changes when the content does


def key_of(library: Library, record: MapRecord) -> str | None:
    """Return the key of a map's image file; None if there is none."""
    if record.satellite_path is None:
        return None
    return _key(library.map_folder(record.slug), record.satellite_path)


def has_tiles(library: Library, record: MapRecord) -> bool:
    """Return whether the tiles of a map's image are ready."""
    key = key_of(library, record)
    return key is not None and _tiles(library.map_folder(record.slug), key).is_dir()


def whole(library: Library, record: MapRecord, *, settings: Settings) -> DisplayFile:
    """Return the image for display: the file, a lighter copy, or a smaller one of a large or unusual image.

    Raises:
        NotFound: The map has no image.
        PhotoError, StorageError, Busy: The copy cannot be made.
    """
    original = _original(library, record)
    mime = _mime(original.path)
    if mime is not None and max(record.satellite_width or 0, record.satellite_height or 0) <= DISPLAY_SIDE_PX:
        if mime == "image/png" and original.path.stat().st_size > _LIGHT_BYTES:
            return _light(library.map_folder(record.slug), original, settings=settings)
        return DisplayFile(original.path, mime, original.key)
    return _small(library, record, original, name="preview", settings=settings)


def copy(library: Library, record: MapRecord, *, settings: Settings) -> DisplayFile:
    """Return a copy without metadata; see `whole`."""
    return _small(library, record, _original(library, record), name="preview", settings=settings)


def thumbnail(library: Library, record: MapRecord, *, settings: Settings) -> DisplayFile:
    """Return a small copy for lists; see `whole`."""
    return _small(library, record, _original(library, record), name="thumbnail", settings=settings)


def floor_key(library: Library, record: MapRecord, *, floor: Floor) -> str | None:
    """Return the key of the image of a floor and its alignment with the map; None if it has no file."""
    original = _floor_original(library, record, floor=floor)
    if original is None:
        return None
    assert floor.image is not None
    laid = (*floor.image.map_from_image, record.satellite_width, record.satellite_height)
    return hashlib.sha256(f"{original.key}|{laid}".encode()).hexdigest()[:16]


def floor_picture(library: Library, record: MapRecord, *, floor: Floor, settings: Settings) -> DisplayFile:
    """Return the image of a floor, resampled to cover the map.

    Raises:
        NotFound: The floor has no image of its own.
        PhotoError, StorageError, Busy: It cannot be made.
    """
    original, key = _floor_original(library, record, floor=floor), floor_key(library, record, floor=floor)
    if original is None or key is None or floor.image is None:
        raise NotFound("the floor has no image of its own", where=f"floor/{floor.id}")
    path = _derived(library.map_folder(record.slug), original.key) / f"floor-{key}.webp"
    if not path.is_file():
        size = (record.satellite_width or 1, record.satellite_height or 1)
        with permit(_READING), opened_raster(original.path, limits=settings.satellite) as raster:
            pixels = warp_to_map(raster, floor.image, size=size, side=DISPLAY_SIDE_PX)
        _encode(path, cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGRA), cv2.IMWRITE_WEBP_QUALITY)
    return DisplayFile(path, "image/webp", key)


def _floor_original(library: Library, record: MapRecord, *, floor: Floor) -> DisplayFile | None:
    if floor.image is None:
        return None
    key = _key(library.map_folder(record.slug), floor.image.path)
    path = photo_path(library.cfg(record.slug), floor.image.path)
    return None if key is None else DisplayFile(path, "", key)


def tile(library: Library, record: MapRecord, *, z: int, x: int, y: int) -> DisplayFile:
    key = key_of(library, record)
    if key is not None:
        folder = _tiles(library.map_folder(record.slug), key) / f"{z}"
        for suffix, mime in ((".jpg", "image/jpeg"), (".webp", "image/webp")):
            path = folder / f"{x}_{y}{suffix}"
            if path.is_file():
                return DisplayFile(path, mime, key)
    raise NotFound("tile not found")


def write_small(folder: Path, name: str, *, small: NDArray[np.uint8], large: bool) -> None:
    """Write the smaller copies of an image.

    Args:
        small: (h, w, 3) uint8. Red, green, blue; at least as large as a preview if the image is.
        large: Whether a preview is needed in addition to the thumbnail.

    Raises:
        NotFound: The image has been deleted since.
    """
    key = _key(folder, name)
    if key is None:
        raise NotFound("the map has no satellite image", where=name, hint="add one on its Image page")
    derived = _derived(folder, key)
    if large:
        _write(derived / "preview.jpg", small, PREVIEW_PX)
    _write(derived / "thumbnail.jpg", small, THUMBNAIL_PX)


def make_tiles(library: Library, map_id: int, *, settings: Settings, progress: Progress) -> bool:
    """Make the tiles of a map's image, unless it has them. Raises PhotoError, StorageError, Cancelled.

    Returns:
        False if the image has another size than its record: the tiles would not fit.
    """
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
    original = _original(library, record)
    with opened_raster(original.path, limits=settings.satellite) as raster:
        if (raster.width, raster.height) != (record.satellite_width, record.satellite_height):
            return False
        write_pyramid(raster, _tiles(library.map_folder(record.slug), original.key), progress=progress)
    return True


def forget(folder: Path, name: str) -> None:
    """Delete an image, the record of its source, and all files derived from it."""
    path, key = folder / name, _key(folder, name)
    if key is not None:
        shutil.rmtree(_derived(folder, key), ignore_errors=True)  # can be made again
        path.with_suffix(".json").unlink(missing_ok=True)
        remove(path)


def _small(
    library: Library, record: MapRecord, original: DisplayFile, *, name: str, settings: Settings
) -> DisplayFile:
    folder = library.map_folder(record.slug)
    path = _derived(folder, original.key) / f"{name}.jpg"
    if not path.is_file():
        with permit(_READING):
            pixels = _read_small(original.path, settings=settings)
        assert record.satellite_path is not None
        write_small(folder, record.satellite_path, small=pixels, large=name == "preview")
    return DisplayFile(path, "image/jpeg", original.key)


def _light(folder: Path, original: DisplayFile, *, settings: Settings) -> DisplayFile:
    """Return a WebP copy of the same size, up to twelve times smaller than the PNG file."""
    path = _derived(folder, original.key) / "whole.webp"
    if not path.is_file():
        with permit(_READING), opened_raster(original.path, limits=settings.satellite) as raster:
            pixels = reduced(raster, DISPLAY_SIDE_PX)
        _encode(path, cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), cv2.IMWRITE_WEBP_QUALITY)
    return DisplayFile(path, "image/webp", original.key)


def _read_small(path: Path, *, settings: Settings) -> NDArray[np.uint8]:
    mime = _mime(path)
    if mime in ("image/png", "image/jpeg", None):
        with opened_raster(path, limits=settings.satellite) as raster:
            return reduced(raster, PREVIEW_PX)
    limits = PhotoLimits(settings.satellite.max_mb, settings.photo.max_megapixels)
    with open_image(path, limits=limits) as image:
        return decode(image, "RGB")


def _original(library: Library, record: MapRecord) -> DisplayFile:
    key = key_of(library, record)
    if key is None or record.satellite_path is None:
        raise NotFound("the map has no satellite image", where=record.slug, hint="add one on its Image page")
    return DisplayFile(photo_path(library.cfg(record.slug), record.satellite_path), "", key)


def _key(folder: Path, name: str) -> str | None:
    """Return the key of an image's previews and tiles; None if the image does not exist."""
    facts = facts_of(folder / name)
    if facts is None:
        return None
    changed_ns, size = facts
    return hashlib.sha256(f"{name}|{size}|{changed_ns}".encode()).hexdigest()[:16]


def _derived(folder: Path, key: str) -> Path:
    return folder / "derived" / "satellite" / key


def _tiles(folder: Path, key: str) -> Path:
    return _derived(folder, key) / "tiles"


def _mime(path: Path) -> str | None:
    with path.open("rb") as file:
        head = file.read(8)
    return next((mime for magic, mime in _MIME if head.startswith(magic)), None)


def shrunk(pixels: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Scale an image down to a maximum length of its longer side, pixels."""
    height, width = pixels.shape[:2]
    scale = min(1.0, side / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _write(path: Path, pixels: NDArray[np.uint8], side: int) -> None:
    small = cv2.cvtColor(shrunk(np.ascontiguousarray(pixels), side), cv2.COLOR_RGB2BGR)
    _encode(path, small, cv2.IMWRITE_JPEG_QUALITY)


def _encode(path: Path, bgr: MatLike, quality: int) -> None:
    """Write a BGR or BGRA image in the format of the file's suffix."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, where=path.name) from error
    write_bytes(path, cv2.imencode(path.suffix, bgr, [quality, _QUALITY])[1].tobytes())
