"""Moves photos and images of a library into its object storage, and deletes objects that nothing names."""

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
from webapp.files.object_storage.marker import MARKER
from webapp.files.object_storage.pointer import (
    SUFFIX,
    pointed_path,
    pointer_path,
    read_pointer,
    write_pointer,
)
from webapp.files.object_storage.storage import ObjectStorage, in_use, is_replaced, is_there
from webapp.files.part_file import discard
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import INNER, Library
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.operate.open_storage import check_owner
from webapp.tasks.satellite.files import images_in_use

_log = logging.getLogger(__name__)

_LOOKS = "orphans.json"
"""File of the library: since when each object is named by nothing, and when that was looked up last."""

_KEY = re.compile(r"[0-9a-f]{2}/[0-9a-f]{64}-[0-9a-f]{16}")
"""What objects of a library are called; whatever else lies below its prefix is not touched."""

_LOOKS_PER_AGE = 4
_READERS_S = 600.0
"""Seconds for which a file stays next to its pointer: who has its path opens it before."""

_SOME = 500


@dataclass(frozen=True, slots=True)
class PhotosMoved:
    """What a move has stored.

    Attributes
    ----------
    stored : int
        Files.
    left : tuple of Path
        Those that could not be stored, for reasons that are in the log.
    """

    stored: int
    left: tuple[Path, ...] = ()


def objects_lock(library: Library) -> FileLock:
    """Make the lock of whoever moves files of a library into its storage, on whatever machine."""
    return FileLock(library.inner / "objects.lock")


def move_photos(library: Library, *, stops: Callable[[], bool] = lambda: False) -> int:
    """Do what `move_locked_photos` does, unless another process is at it.

    Returns
    -------
    int
        Files stored.

    Raises
    ------
    StorageError
        As there.
    """
    if in_use() is None:
        return 0
    try:
        with objects_lock(library).acquire(timeout=0):
            return move_locked_photos(library, stops=stops).stored
    except Timeout:
        return 0


def move_locked_photos(library: Library, *, stops: Callable[[], bool] = lambda: False) -> PhotosMoved:
    """Make objects of photos and images that came as files: by an import, or before there was a storage.

    The caller holds the lock `objects_lock`. Images are files in any case until this moves them: who places
    one waits for no upload.

    Parameters
    ----------
    stops : callable
        Asked before each file whether to end.

    Raises
    ------
    StorageError
        The storage or the disk refused; what is not stored is still a file.
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
    """Name the images and photos of all maps, whether or not they are files."""
    with library.database.read() as session:
        records = [(one.id, one.slug, images_in_use(one)) for one in session.scalars(select(MapRecord))]
    for id, slug, images in records:
        yield from (library.map_folder(slug) / name for name in sorted(images))
        with library.database.read() as session:
            names = session.scalars(select(Photo.path).where(Photo.map_id == id).order_by(Photo.id)).all()
        yield from (library.map_folder(slug) / name for name in names)


def _move(storage: ObjectStorage, path: Path) -> bool:
    """Store what is a file, or was replaced by one; delete the file of one stored a while ago."""
    if not path.is_file() or path.is_symlink():
        return False
    pointer = read_pointer(path)
    if pointer is None or is_replaced(path, pointer):
        pointer = storage.store(path)
        write_pointer(path, pointer)
        if not path.is_file():  # deleted for good meanwhile: nothing is to name the object
            discard(pointer_path(path))
            return False
        storage.cache.adopt(path, pointer, name=path.name)
        return True
    if time.time() - pointer_path(path).stat().st_mtime > _READERS_S:
        discard(path)
    return False


def sweep_objects(library: Library, settings: Settings, *, stops: Callable[[], bool] = lambda: False) -> int:
    """Delete objects that nothing in the library's folder has named for `orphans_h` hours.

    An upload that was interrupted leaves such an object, and so does a map that is deleted for good. Nobody
    is reading one by then, and none of them is ever named again: every upload has a key of its own.

    Parameters
    ----------
    stops : callable
        Asked before each pointer and each object whether to end; what is left is done the next time.

    Returns
    -------
    int
        Objects deleted.

    Raises
    ------
    StorageError
        The folder cannot be read completely, or the storage refused: then nothing more is deleted.
    """
    storage, age = in_use(), timedelta(hours=settings.orphans_h)
    if storage is None:
        return 0
    try:
        with FileLock(library.inner / "orphans.lock", timeout=0):
            at, (looked_at, since) = now(), _read_looks(library)
            if looked_at is not None and at - looked_at < age / _LOOKS_PER_AGE:
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
            _write_looks(library, at, {key: first for key, first in since.items() if key not in swept})
            return len(swept)
    except Timeout:
        return 0  # another worker is at it


def _unnamed(
    library: Library,
    storage: ObjectStorage,
    before: Mapping[str, datetime],
    *,
    at: datetime,
    stops: Callable[[], bool],
) -> dict[str, datetime] | None:
    """List the objects that nothing names, and since when; None when it was stopped."""
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
    """Find the files that pointers stand for, everywhere in the folder of a library.

    Raises
    ------
    StorageError
        Not all of the folder can be read.
    """

    def fail(error: OSError) -> None:
        raise StorageError(
            f"the folder cannot be read: {error.strerror}; no object is deleted", where=error.filename
        ) from error

    for parent, _, files in os.walk(folder, onerror=fail):
        for name in files:
            if name.startswith(".") and name.endswith(SUFFIX):
                yield pointed_path(Path(parent, name))
    if not (folder / INNER / MARKER).is_file():
        raise StorageError("the folder is not mounted any more; no object is deleted", where=str(folder))


def _delete(
    library: Library, storage: ObjectStorage, keys: Iterable[str], *, stops: Callable[[], bool]
) -> set[str]:
    """Delete objects, but none with a photo in it whose file is missing: somebody has lost the pointer."""
    by_hash: dict[str, list[str]] = {}
    for key in keys:
        by_hash.setdefault(key.rpartition("/")[2].partition("-")[0], []).append(key)
    needed = _missing(library, list(by_hash))
    if needed:
        _log.warning("%d photos have lost their files, and their objects are kept", len(needed))
    deleted: set[str] = set()
    for sha256, same in by_hash.items():
        for key in same if sha256 not in needed else ():
            if stops():
                return deleted
            storage.bucket.delete(key)
            deleted.add(key)
    return deleted


def _missing(library: Library, hashes: list[str]) -> set[str]:
    """List which of these contents a photo has whose file is neither here nor an object."""
    found = set()
    for start in range(0, len(hashes), _SOME):
        some = hashes[start : start + _SOME]
        rows = select(Photo.sha256, Photo.path, MapRecord.slug).join(MapRecord).where(Photo.sha256.in_(some))
        with library.database.read() as session:
            for sha256, path, slug in session.execute(rows):
                if not is_there(library.map_folder(slug) / path):
                    found.add(sha256)
    return found


def _read_looks(library: Library) -> tuple[datetime | None, dict[str, datetime]]:
    """Read what was found before; a damaged file only costs time."""
    try:
        content = json.loads((library.inner / _LOOKS).read_bytes())
        since = {key: datetime.fromisoformat(first) for key, first in content["since"].items()}
        return datetime.fromisoformat(content["looked_at"]), since
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        return None, {}


def _write_looks(library: Library, at: datetime, since: Mapping[str, datetime]) -> None:
    content = {"looked_at": at.isoformat(), "since": {key: first.isoformat() for key, first in since.items()}}
    write_text(library.inner / _LOOKS, json.dumps(content))
