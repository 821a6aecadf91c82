"""Copies a map of the library: the same photos, places and placements under a new name."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import NotFound, StorageError
from webapp.files.contents import with_pointer
from webapp.files.listing import DERIVED
from webapp.files.maps.lists import LISTS
from webapp.files.photos.photo import SIDES, preview_path
from webapp.progress import Progress
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere
from webapp.tasks.evaluation import stored as stored_evaluation
from webapp.tasks.landmarks import photo_pieces
from webapp.tasks.maps import adopt_map
from webapp.tasks.maps.library_map import floors

_RECORD_FIELDS = (
    "description",
    "uses_adopted",
    "next_id",
    "satellite_path",
    "satellite_width",
    "satellite_height",
    "georeference",
    *LISTS,
)
_NOT_COPIED = frozenset(
    {"exports", "intake", "health.json", "photo-plan.json", photo_pieces.STORED, stored_evaluation.FILE}
)
"""Files and folders in `derived` that are valid for the original map only."""


def duplicate_map(
    library: Library, map_id: int, *, account_id: int, name: str, progress: Progress | None = None
) -> str:
    """Duplicate a map, without its history and removed photos.

    Photos, images and indexes are never changed in place, so that both maps can share them by hard links.

    Raises:
        NotFound, UsageError: The map does not exist, or the name is not valid.
        StorageError, Cancelled: No copy was made.
    """
    name = maps.checked_name(name)
    with library.database.read() as session:
        original = _read(session, map_id)
    there = library.map_folder(original.record.slug)
    place = adopt_map.make_staging(library)
    try:
        wanted = _files(there, original.record, original.photos)
        _copy_files(there, place / "map", wanted=wanted, progress=progress or Progress())
        copy = _register(library, original, place / "map", name=name, account_id=account_id)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return copy.slug


@dataclass(frozen=True, slots=True)
class _Original:
    """The records of the map when the copy was begun."""

    record: MapRecord
    photos: list[Photo]
    placed: list[PlacedElsewhere]


def _read(session: Session, map_id: int) -> _Original:
    """Read the records of a map, without removed photos."""
    record = session.get(MapRecord, map_id)
    if record is None:
        raise NotFound("map not found")
    photos = [photo for photo in maps.photos(session, record) if not photo.removed]
    ids = {photo.id for photo in photos}
    placed = session.scalars(select(PlacedElsewhere).where(PlacedElsewhere.map_id == record.id)).all()
    return _Original(record, photos, [row for row in placed if row.photo_id in ids])


def _register(library: Library, original: _Original, files: Path, *, name: str, account_id: int) -> MapRecord:
    """Create the records and move the files into the library; on failure, keep neither."""
    folder: Path | None = None
    kept = False
    try:
        with library.database.write() as session:
            folders = [path.name for path in library.folder.iterdir()]
            copy = maps.create(session, name, account_id=account_id, folders=folders)
            for field in _RECORD_FIELDS:
                setattr(copy, field, getattr(original.record, field))
            session.add_all(_same(photo, copy.id, revision=0) for photo in original.photos)
            session.add_all(_same(row, copy.id) for row in original.placed)
            session.flush()
            adopt_map.queue_derived(session, copy)
            folder = library.map_folder(copy.slug)
            files.rename(folder)
        kept = True
    finally:
        if folder is not None and not kept:
            shutil.rmtree(folder, ignore_errors=True)
    return copy


def _same(row: Photo | PlacedElsewhere, map_id: int, **other: int) -> Photo | PlacedElsewhere:
    """Make a record with the same values, except `other`, for another map."""
    values = {column.key: getattr(row, column.key) for column in row.__table__.columns}
    return type(row)(**{**values, "map_id": map_id, **other})


def _copy_files(source: Path, target: Path, *, wanted: Iterable[Path], progress: Progress) -> None:
    try:
        target.mkdir()
        files = [file for file in dict.fromkeys(wanted) if _is_inside(file, source.resolve())]
        progress.size(len(files))
        for file in files:
            progress.check()
            copy = target / file.relative_to(source)
            copy.parent.mkdir(parents=True, exist_ok=True)
            _link(file, copy)
            progress.advance()
    except OSError as error:
        raise StorageError(
            f"the map cannot be copied: {error.strerror or error}",
            where=error.filename,
            hint="check the free space on the disk of the library",
        ) from error


def _files(folder: Path, record: MapRecord, photos: Sequence[Photo]) -> Iterator[Path]:
    """Yield the files of a map, except its text files, which are generated anew."""
    for photo in photos:
        yield from with_pointer(folder / photo.path)
    for image in (record.satellite_path, *(floor.image.path for floor in floors(record) if floor.image)):
        if image is not None:
            yield from (*with_pointer(folder / image), (folder / image).with_suffix(".json"))
    previews = {
        preview_path(folder, photo.id, kind=kind, blurred=boxes_of(photo))
        for photo in photos
        for kind in SIDES
    }
    holding = {path.parent for path in previews}
    for parent, folders, files in os.walk(folder / DERIVED):
        here = Path(parent)
        folders[:] = [name for name in folders if here.name != DERIVED or name not in _NOT_COPIED]
        for path in (here / name for name in sorted(files)):
            passing = path.name.endswith(("lock", ".tmp", ".part")) or path.name in _NOT_COPIED
            gone = here in holding and path not in previews
            if not passing and not gone:
                yield path


def _is_inside(file: Path, folder: Path) -> bool:
    """Return whether a file exists in a folder and is not reached by a symbolic link."""
    return file.is_file() and not file.is_symlink() and file.resolve().is_relative_to(folder)


def _link(source: Path, target: Path) -> None:
    """Hard-link a file; copy it if the file system has no hard links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
