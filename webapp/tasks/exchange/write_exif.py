"""Writes the positions and headings of a map's photos to EXIF, in copies or in place, or to sidecar files."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import Experience
from webapp.errors import MapError, PhotoError, UsageError
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.files.maps.folder import photo_path
from webapp.files.photos.exif import Gps, NoGps
from webapp.files.photos.exif_write import Geotag, format_exiftool_csv, format_xmp, with_position
from webapp.files.photos.photo import read_facts, read_file
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.store.library import has_library
from webapp.tasks.exchange.export_source import Download, Source

BACKUP = "_original"
"""Suffix of the backup of a photo, as exiftool names it."""

_SAME_PX = 1.0
"""A photo this close to its EXIF position counts as placed by GPS: map files may hold whole pixels."""


@dataclass(frozen=True, slots=True)
class PhotoCopy:
    id: int
    photo: str  # Path in the map's folder, and in that of the copies
    position: LatLon | None = None  # As written; None if nothing was written
    heading_deg: float | None = None
    reason: str | None = None  # Why nothing was written, or what could not be kept


def write_exif(
    source: Source, out: Path | None, *, limits: PhotoLimits, progress: Progress | None = None
) -> Iterator[PhotoCopy]:
    """Write positions and headings into copies of the photos of a map, or into the photos.

    Args:
        out: Folder of the copies, created if missing; photos have the same paths below it as below the map's
            folder, and no file there is replaced. None: the photos themselves are changed, each with a backup
            `NAME_original` next to it; an existing backup is kept.

    Yields:
        For each photo of the map, once it is written.

    Raises:
        UsageError: The map has no georeference, `out` is its own folder, or the photos of a library would be
            changed.
        Cancelled
    """
    georeference = source.georeference()
    folder = source.cfg.parent.resolve()
    if out is not None and out.resolve() == folder:
        raise UsageError(
            "the copies would be written among the originals", where=str(out), hint="name another folder"
        )
    if out is None and has_library(folder.parent):
        raise UsageError(
            "photos of a library are not changed", where=str(folder), hint="write copies into another folder"
        )
    progress = progress or Progress()
    progress.size(len(source.map.experiences))
    return _written(source, out, georeference, limits=limits, progress=progress)


def export_geotagged(source: Source, *, limits: PhotoLimits, progress: Progress | None = None) -> Download:
    """Return a zip of copies of the photos with positions in EXIF, generated while it is streamed.

    A photo that cannot be written has an XMP sidecar instead, if its position is known; `not-written.txt`
    lists these photos with the reason.
    """
    members = _members(source, source.georeference(), limits=limits, progress=progress or Progress())
    return Download(f"{source.name}-photos.zip", "application/zip", stream_zip(members))


def export_sidecars(source: Source, *, limits: PhotoLimits) -> Download:
    """Return a zip with an XMP file for each photo, generated while it is streamed."""
    tags = _tags(source, source.georeference(), limits=limits)
    members = (ZipMember(f"{name}.xmp", format_xmp(tag)) for name, tag in tags)
    return Download(f"{source.name}-xmp.zip", "application/zip", stream_zip(members))


def export_exiftool_csv(source: Source, *, limits: PhotoLimits) -> Download:
    """Return a table from which exiftool can tag the photos."""
    tags = _tags(source, source.georeference(), limits=limits)
    return Download(f"{source.name}.csv", "text/csv; charset=utf-8", format_exiftool_csv(tags))


def _written(
    source: Source, out: Path | None, georeference: Georeference, *, limits: PhotoLimits, progress: Progress
) -> Iterator[PhotoCopy]:
    for e in source.map.experiences:
        progress.check()
        try:
            path = photo_path(source.cfg, e.photo)
            data, tag, note = _geotagged(path, e, georeference, limits=limits)
            if out is None:
                _replace(path, data)
            else:
                _add(out / e.photo, data)
            yield PhotoCopy(e.id, e.photo, tag.position, e.heading_deg, note)
        except (MapError, PhotoError) as error:
            yield PhotoCopy(e.id, e.photo, reason=error.message)
        progress.advance()


def _members(
    source: Source, georeference: Georeference, *, limits: PhotoLimits, progress: Progress
) -> Iterator[ZipMember]:
    names = _names(source)
    progress.size(len(names))
    left: list[str] = []
    for e in source.map.experiences:
        progress.check()
        name = names[e.id]
        try:
            path = photo_path(source.cfg, e.photo)
            yield ZipMember(name, _geotagged(path, e, georeference, limits=limits)[0])
        except (MapError, PhotoError) as error:
            tag = _tag_of(source, e, georeference, limits=limits)
            if tag is not None:
                yield ZipMember(f"{name}.xmp", format_xmp(tag))
            left.append(f"{name}: {error.message}\n")
        progress.advance()
    if left:
        yield ZipMember("not-written.txt", "".join(left).encode("utf-8", "replace"))


def _tags(source: Source, georeference: Georeference, *, limits: PhotoLimits) -> Iterator[tuple[str, Geotag]]:
    """Yield name and geotag of the photos that have a position on the Earth."""
    names = _names(source)
    for e in source.map.experiences:
        tag = _tag_of(source, e, georeference, limits=limits)
        if tag is not None:
            yield names[e.id], tag


def _tag_of(
    source: Source, e: Experience, georeference: Georeference, *, limits: PhotoLimits
) -> Geotag | None:
    """Return the geotag of a photo, also if its file cannot be read; None without a position on the Earth."""
    gps: Gps | NoGps | None = None
    with suppress(MapError, PhotoError):
        gps = read_facts(photo_path(source.cfg, e.photo), limits=limits).gps
    with suppress(PhotoError):
        return _geotag(e, georeference, gps=gps)
    return None


def _geotagged(
    path: Path, e: Experience, georeference: Georeference, *, limits: PhotoLimits
) -> tuple[bytes, Geotag, str | None]:
    photo = read_file(path, limits=limits)
    tag = _geotag(e, georeference, gps=read_facts(photo, limits=limits).gps)
    data, note = with_position(photo, tag, limits=limits)
    return data, tag, note


def _geotag(e: Experience, georeference: Georeference, *, gps: Gps | NoGps | None) -> Geotag:
    """Return the geotag of a photo, marked as GPS if its place agrees with the position in EXIF."""
    at = georeference.latlon_of(e.position)
    if not (abs(at.lat) <= 90.0 and abs(at.lon) <= 180.0):  # or NaN: beyond the horizon
        raise PhotoError("its position on the map has no coordinates on the Earth")
    if not isinstance(gps, Gps):
        return Geotag(at, e.heading_deg)
    x, y = georeference.pixel_of(LatLon(gps.lat, gps.lon))
    if not max(abs(x - e.position.x), abs(y - e.position.y)) <= _SAME_PX:  # or NaN
        return Geotag(at, e.heading_deg)
    return Geotag(at, e.heading_deg, by_gps=True, accuracy_m=e.gps_accuracy_m or gps.accuracy_m)


def _names(source: Source) -> dict[int, str]:
    """Return the original file names of the photos; their paths where several have the same name."""
    own = {e.id: e.name or PurePosixPath(e.photo).name for e in source.map.experiences}
    count = Counter(name.casefold() for name in own.values())
    return {e.id: own[e.id] if count[own[e.id].casefold()] == 1 else e.photo for e in source.map.experiences}


def _add(target: Path, data: bytes) -> None:
    if target.exists() or target.is_symlink():
        raise PhotoError("a file of that name already exists")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, where=str(target.parent)) from error
    write_bytes(target, data)


def _replace(path: Path, data: bytes) -> None:
    """Back up the original next to the photo, unless a backup exists, and replace the photo."""
    backup = path.with_name(path.name + BACKUP)
    part = path.with_name(f".{path.name}{BACKUP}.tmp")
    try:
        if not backup.exists():  # an existing backup is the original
            shutil.copy2(path, part)
            part.replace(backup)
    except OSError as error:
        raise storage_error(error, where=str(backup)) from error
    write_bytes(path, data)
