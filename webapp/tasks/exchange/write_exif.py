"""Copies of a map's photos with the positions and headings of the map in their EXIF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import Experience
from webapp.errors import MapError, PhotoError, UsageError
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.maps.folder import photo_path
from webapp.files.photos.exif_write import with_position
from webapp.files.photos.photo import read_file
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.exchange.export_source import Source


@dataclass(frozen=True, slots=True)
class PhotoCopy:
    """What was done with a photo.

    Attributes
    ----------
    photo : str
        Path in the map's folder, and in that of the copies.
    position : LatLon or None
        As written; None where the photo was not copied.
    reason : str or None
        Why it was not copied, or what could not be kept in the copy.
    """

    id: int
    photo: str
    position: LatLon | None = None
    heading_deg: float | None = None
    reason: str | None = None


def write_exif(
    source: Source, out: Path, *, limits: PhotoLimits, progress: Progress | None = None
) -> Iterator[PhotoCopy]:
    """Copy the photos of a map into another folder, with positions and headings; the originals stay.

    A file that is there already is never replaced.

    Parameters
    ----------
    out : Path
        Made where it does not exist. Photos have the same paths below it as below the map's folder.
    progress : Progress, optional
        One step a photo.

    Yields
    ------
    PhotoCopy
        For each photo of the map, once it is on the disk.

    Raises
    ------
    UsageError
        The map has no georeference, or `out` is its own folder.
    StorageError
        A copy cannot be written.
    Cancelled
    """
    georeference = source.georeference()
    if out.resolve() == source.cfg.parent.resolve():
        raise UsageError(
            "the copies would be written among the originals", where=str(out), hint="name another folder"
        )
    progress = progress or Progress()
    progress.size(len(source.map.experiences))
    return _copies(source, out, georeference, limits=limits, progress=progress)


def _copies(
    source: Source, out: Path, georeference: Georeference, *, limits: PhotoLimits, progress: Progress
) -> Iterator[PhotoCopy]:
    for e in source.map.experiences:
        progress.check()
        try:
            yield _copy(source.cfg, e, georeference, out=out, limits=limits)
        except (MapError, PhotoError) as error:
            yield PhotoCopy(e.id, e.photo, reason=error.message)
        progress.advance()


def _copy(
    cfg: Path, e: Experience, georeference: Georeference, *, out: Path, limits: PhotoLimits
) -> PhotoCopy:
    at = georeference.latlon_of(e.position)
    if not (abs(at.lat) <= 90.0 and abs(at.lon) <= 180.0):  # also not NaN, beyond the horizon
        raise PhotoError("its position on the map has no coordinates on the Earth")
    original = read_file(photo_path(cfg, e.photo), limits=limits)
    data, note = with_position(original, at, heading_deg=e.heading_deg, limits=limits)
    target = out / e.photo
    if target.exists() or target.is_symlink():
        raise PhotoError("a file of that name already exists")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, where=str(target.parent)) from error
    write_bytes(target, data)
    return PhotoCopy(e.id, e.photo, at, e.heading_deg, note)
