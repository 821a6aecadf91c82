"""Adds a photo to a mission: checks and stores it, and makes its previews."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path, PurePosixPath

from webapp.errors import NotFound
from webapp.files.part_file import move_in, show_file_as
from webapp.files.photos.photo import PhotoFacts, make_previews, previews_folder, read_facts, write_previews
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionObject, MissionPhoto
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.maps.add_photo import suffix_of, tidy_name
from webapp.tasks.maps.pictures import PhotoFile

PHOTOS = "photos"
"""Name of the folder of photos in the folder of a mission."""

_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_-]+")
_MAX_STEM = 40


@dataclass(frozen=True, slots=True)
class PhotoMetadata:
    # When it was taken, Unix seconds; defaults to the EXIF time, if that has a time zone.
    time_s: float | None = None
    object_id: str | None = None  # The object of the mission that it shows


def add_mission_photo(
    library: Library, mission_id: int, *, source: Path, name: str, about: PhotoMetadata, settings: Settings
) -> MissionPhoto:
    """Add a photo to a mission; if it has the same content as an existing one, only update the metadata.

    When this returns, photo and record are on the disk.

    Args:
        source: Complete file on the same disk as the library; it is moved or deleted.
        name: Name of the original file; any text.

    Raises:
        PhotoError: The file is not a photo of a known format, damaged, truncated, or larger than the limits.
            `source` is left unchanged.
        NotFound: The mission no longer exists.
        DiskFull, StorageError: Writing failed.
    """
    name = tidy_name(name)
    with show_file_as(name, source):
        facts = read_facts(source, limits=settings.photo)
        previews = make_previews(source, limits=settings.photo)
    with source.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    row = MissionPhoto(
        mission_id=mission_id,
        sha256=sha256,
        name=name,
        path=_path(name, sha256, suffix=suffix_of(facts)),
        width=facts.width,
        height=facts.height,
        size_bytes=source.stat().st_size,
        time_s=about.time_s if about.time_s is not None else _taken(facts),
        object_id=about.object_id,
    )
    folder = missions.folder(library, mission_id)
    with library.database.write() as session:
        mission = session.get_one(Mission, mission_id, with_for_update=True)
        known = session.get(MissionPhoto, (mission_id, sha256))
        if known is None:
            session.add(row)
        kept = known or row
        kept.time_s = about.time_s if about.time_s is not None else kept.time_s
        kept.object_id = about.object_id or kept.object_id
        _keep(source, folder / kept.path)
        missions.count_change(mission)
        shown = session.get(MissionObject, (mission_id, kept.object_id)) if kept.object_id else None
        if shown is not None and shown.photo_sha is None:
            shown.photo_sha, shown.revision = sha256, mission.revision
        write_previews(previews_folder(folder), sha256, previews=previews)
    return kept


def original(library: Library, photo: MissionPhoto) -> Path:
    """Find the original file of a photo.

    Raises:
        NotFound: The file is missing on the disk.
    """
    path = missions.folder(library, photo.mission_id) / photo.path
    if not path.is_file():
        raise NotFound("the file of this photo is missing", where=photo.name, hint="send it again")
    return path


def file_of(library: Library, photo: MissionPhoto) -> PhotoFile:
    """Return a photo as its pictures are made of it."""
    folder = missions.folder(library, photo.mission_id)
    return PhotoFile(
        photo.name,
        photo.sha256,
        partial(original, library, photo),
        previews_folder(folder),
        photo.sha256,
    )


def _path(name: str, sha256: str, *, suffix: str) -> str:
    """Return the path of a photo; the beginning of its hash makes it unique."""
    stem = PurePosixPath(name.replace("\\", "/")).stem
    plain = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    return f"{PHOTOS}/{sha256[:16]}-{_NOT_PLAIN.sub('-', plain)[:_MAX_STEM].strip('-') or 'photo'}.{suffix}"


def _taken(facts: PhotoFacts) -> float | None:
    """Return the EXIF time of a photo, if it has a time zone."""
    taken = None if facts.taken_at is None else datetime.fromisoformat(facts.taken_at)
    return None if taken is None or taken.tzinfo is None else taken.timestamp()


def _keep(source: Path, target: Path) -> None:
    if target.exists():
        source.unlink()
    else:
        move_in(source, target)
