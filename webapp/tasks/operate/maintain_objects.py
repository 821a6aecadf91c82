"""Moves photos and images of a library to its object storage, and deletes unreferenced objects."""

from __future__ import annotations

import json
import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from filelock import FileLock, Timeout
from sqlalchemy import select

from webapp.errors import DiskFull, StorageError, StorageUnavailable
from webapp.files.atomic import write_text
from webapp.files.contents import in_use, is_replaced, is_there
from webapp.files.object_storage.cache import (
    SUFFIX,
    pointed_path,
    pointer_path,
    read_pointer,
    write_pointer,
)
from webapp.files.object_storage.storage import MARKER, ObjectStorage
from webapp.files.part_file import discard
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import INNER, Library
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.operate.open_storage import check_owner
from webapp.tasks.satellite.files import images_in_use

_log = logging.getLogger(__name__)

_ORPHANS = "orphans.json"
"""File of the library: since when each object is unreferenced, and the time of the last scan."""

_KEY = re.compile(r"[0-9a-f]{2}/[0-9a-f]{64}-[0-9a-f]{16}")
"""Names of a library's objects; other objects with its prefix are not touched."""

_SCANS_PER_AGE = 4
_READERS_S = 600.0
"""Seconds for which a file stays next to its pointer, for readers that have already looked up its path."""

_SOME = 500


@dataclass(frozen=True, slots=True)
class PhotosMoved:
    stored: int  # Number of files stored
    left: tuple[Path, ...] = ()  # Files that could not be stored; the reasons are in the log


def objects_lock(library: Library) -> FileLock:
    """Return the lock under which files of a library are moved to its storage, on any machine."""
    return FileLock(library.inner / "objects.lock")


def move_photos(library: Library, *, stops: Callable[[], bool] = lambda: False) -> int:
    """Call `move_locked_photos`, unless another process is moving files; return how many were stored."""
    if in_use() is None:
        return 0
    try:
        with objects_lock(library).acquire(timeout=0):
            return move_locked_photos(library, stops=stops).stored
    except Timeout:
        return 0


def move_locked_photos(library: Library, *, stops: Callable[[], bool] = lambda: False) -> PhotosMoved:
    """Move photos and images that are still files to the object storage.

    These are imported photos, those from before the storage was set up, and all images, which are first saved
    as files so that placing one need not wait for an upload. The caller holds the lock `objects_lock`.

    Args:
        stops: Called before each file; True ends the move.

    Raises:
        StorageError: The storage or the disk failed; files that are not stored remain in the folder.
    """
    storage = in_use()
    if storage is None:
        return PhotosMoved(0)
    stored = 0
    left: list[Path] = []
    for path in _paths(library):
        if stops():
            break
        try:
            stored += _move(storage, path)
        except (StorageUnavailable, DiskFull):
            raise
        except (StorageError, OSError) as error:
            _log.warning("%s is not moved to the object storage: %s", path, error)
            left.append(path)
    return PhotosMoved(stored, tuple(left))


def _paths(library: Library) -> Iterator[Path]:
    """Yield the paths of the images and photos of all maps, whether or not they are files."""
    with library.database.read() as session:
        records = [(one.id, one.slug, images_in_use(one)) for one in session.scalars(select(MapRecord))]
    for id, slug, images in records:
        yield from (library.map_folder(slug) / name for name in sorted(images))
        with library.database.read() as session:
            names = session.scalars(select(Photo.path).where(Photo.map_id == id).order_by(Photo.id)).all()
        yield from (library.map_folder(slug) / name for name in names)


def _move(storage: ObjectStorage, path: Path) -> bool:
    """Store a new or replaced file; delete one whose pointer is older than `_READERS_S`."""
    if not path.is_file() or path.is_symlink():
        return False
    pointer = read_pointer(path)
    if pointer is None or is_replaced(path, pointer):
        pointer = storage.store(path)
        write_pointer(path, pointer)
        if not path.is_file():  # deleted permanently meanwhile: the object must not be referenced
            discard(pointer_path(path))
            return False
        storage.cache.adopt(path, pointer, name=path.name)
        return True
    if time.time() - pointer_path(path).stat().st_mtime > _READERS_S:
        discard(path)
    return False


def sweep_objects(library: Library, settings: Settings, *, stops: Callable[[], bool] = lambda: False) -> int:
    """Delete objects to which no pointer in the library's folder has referred for `orphans_h` hours.

    Interrupted uploads and permanently deleted maps leave such objects. By then nothing reads them, and they
    cannot be referenced again, as each upload has a unique key.

    Args:
        stops: Called before each pointer and each object; True ends the sweep until the next time.

    Returns:
        Number of objects deleted.

    Raises:
        StorageError: The folder cannot be read completely, or the storage failed; the sweep ends.
    """
    storage, age = in_use(), timedelta(hours=settings.orphans_h)
    if storage is None:
        return 0
    try:
        with FileLock(library.inner / "orphans.lock", timeout=0):
            at, (scanned_at, since) = now(), _read_scan(library)
            if scanned_at is not None and at - scanned_at < age / _SCANS_PER_AGE:
                return 0
            found = _unnamed(library, storage, since, at=at, stops=stops)
            if found is None:
                return 0
            since = found
            check_owner(library.inner, storage)
            gone = [key for key, first in since.items() if at - first >= age]
            swept = _delete(library, storage, gone, stops=stops)
            if stops():
                return len(swept)
            storage.bucket.drop_unfinished(begun_before=at - age)
            _write_scan(library, at, {key: first for key, first in since.items() if key not in swept})
            return len(swept)
    except Timeout:
        return 0  # another worker is sweeping


def _unnamed(
    library: Library,
    storage: ObjectStorage,
    before: Mapping[str, datetime],
    *,
    at: datetime,
    stops: Callable[[], bool],
) -> dict[str, datetime] | None:
    """Return the unreferenced objects, and since when; None if stopped."""
    there, named = [], set()
    for one in storage.bucket.objects():
        if stops():
            return None
        if _KEY.fullmatch(one.key):
            there.append(one.key)
    for path in pointed_files(library.folder):
        if stops():
            return None
        if pointer := read_pointer(path):
            named.add(pointer.key)
    return {key: before.get(key, at) for key in there if key not in named}


def pointed_files(folder: Path) -> Iterator[Path]:
    """Find the paths of all files that have pointers in the folder of a library."""

    def fail(error: OSError) -> None:
        raise StorageError(
            f"the folder cannot be read: {error.strerror}; no object is deleted", where=error.filename
        ) from error

    for parent, _, files in os.walk(folder, onerror=fail):
        for name in files:
            if name.startswith(".") and name.endswith(SUFFIX):
                yield pointed_path(Path(parent, name))
    if not (folder / INNER / MARKER).is_file():
        raise StorageError("the folder is no longer mounted; no object is deleted", where=str(folder))


def _delete(
    library: Library, storage: ObjectStorage, keys: Iterable[str], *, stops: Callable[[], bool]
) -> set[str]:
    """Delete objects, except those of photos whose file and pointer are missing (lost pointers)."""
    by_hash: dict[str, list[str]] = {}
    for key in keys:
        by_hash.setdefault(key.rpartition("/")[2].partition("-")[0], []).append(key)
    needed = _missing(library, list(by_hash))
    if needed:
        _log.warning("%d photos have no file; their objects are kept", len(needed))
    deleted: set[str] = set()
    for sha256, same in by_hash.items():
        for key in same if sha256 not in needed else ():
            if stops():
                return deleted
            storage.bucket.delete(key)
            deleted.add(key)
    return deleted


def _missing(library: Library, hashes: list[str]) -> set[str]:
    """Return those of the hashes that belong to photos with neither a file nor a pointer."""
    found = set()
    for start in range(0, len(hashes), _SOME):
        some = hashes[start : start + _SOME]
        rows = select(Photo.sha256, Photo.path, MapRecord.slug).join(MapRecord).where(Photo.sha256.in_(some))
        with library.database.read() as session:
            for sha256, path, slug in session.execute(rows):
                if not is_there(library.map_folder(slug) / path):
                    found.add(sha256)
    return found


def _read_scan(library: Library) -> tuple[datetime | None, dict[str, datetime]]:
    """Read the result of the last scan; a damaged file counts as none."""
    try:
        content = json.loads((library.inner / _ORPHANS).read_bytes())
        since = {key: datetime.fromisoformat(first) for key, first in content["since"].items()}
        return datetime.fromisoformat(content["looked_at"]), since
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        return None, {}


def _write_scan(library: Library, at: datetime, since: Mapping[str, datetime]) -> None:
    content = {"looked_at": at.isoformat(), "since": {key: first.isoformat() for key, first in since.items()}}
    write_text(library.inner / _ORPHANS, json.dumps(content))
