"""Moves the files of a library to its object storage, or back to its folder.

Each file is in at least one of the two places at any time: an interrupted move leaves a usable library, and
is continued by running the same command again. No object is deleted.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import Timeout

from webapp.errors import Busy, ObjectLost, StorageError, UsageError
from webapp.files.object_storage.connect import connect
from webapp.files.object_storage.marker import MARKER, check_marker, read_marker
from webapp.files.object_storage.storage import bring_back
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.database import Database
from webapp.store.library import INNER, Library
from webapp.tasks.operate.maintain_objects import move_locked_photos, objects_lock, pointed_files
from webapp.tasks.operate.move import alone, check_alone
from webapp.tasks.operate.open_storage import check_owner

_TOGETHER, _SOME = 4, 32
"""Objects fetched concurrently, and between two checks for cancellation."""

_WAIT_S, _LOOK_S = 600.0, 1.0
"""Seconds to wait for a worker that moves the same files, and between two checks for cancellation."""


@dataclass(frozen=True, slots=True)
class ObjectsMoved:
    """What was moved."""

    files: int  # Number of files moved
    place: str  # Where they are now


def move_to_storage(library: Library, settings: Settings, *, progress: Progress) -> ObjectsMoved:
    """Move photos and images of a library with an open storage; indexes are moved when they are next built.

    Servers and workers may keep running: they do the same every hour, and delete the files that are no longer
    read. If a worker is moving files, this waits for it.

    Raises:
        UsageError: The settings name no storage.
        Busy: The worker has not finished in time.
        StorageError: Some files could not be stored and remain in the folder.
        Cancelled
    """
    if settings.storage is None:
        raise UsageError(
            "the address of the object storage is needed",
            where="EXPMAP_STORAGE",
            hint="set it: s3://bucket/prefix",
        )

    def stops() -> bool:
        progress.check()
        progress.advance()
        return False

    with _exclusively(library, progress=progress):
        moved = move_locked_photos(library, stops=stops)
    if moved.left:
        left, all_ = len(moved.left), len(moved.left) + moved.stored
        raise StorageError(
            f"{left} of {all_} files could not be stored and stay in the folder",
            where=str(moved.left[0].relative_to(library.folder)),
            hint="run it again; the log says what was wrong with each",
        )
    return ObjectsMoved(moved.stored, settings.storage)


@contextmanager
def _exclusively(library: Library, *, progress: Progress) -> Iterator[None]:
    """Hold the lock for moving files during the block; wait for a worker that holds it."""
    lock, until = objects_lock(library), time.monotonic() + _WAIT_S
    is_noted = False
    while not lock.is_locked:
        progress.check()
        try:
            lock.acquire(timeout=min(_LOOK_S, _WAIT_S))
        except Timeout as error:
            if time.monotonic() >= until:
                raise Busy(
                    "a worker is moving the photos of this library already",
                    wait_s=60,
                    where=str(library.folder),
                    hint="it goes on by itself; run it again later, to see whether all are stored",
                ) from error
            if not is_noted:
                progress.note("waiting for a worker that moves the same files")
                is_noted = True
    try:
        yield
    finally:
        lock.release()


def move_to_folder(folder: Path, settings: Settings, *, progress: Progress) -> ObjectsMoved:
    """Fetch all objects of a library as files, verify their hashes, and detach the storage.

    Args:
        progress: One step per object.

    Raises:
        UsageError: The library has no storage.
        Conflict: The library is in use.
        StorageUnavailable, DiskFull, StorageError: The disk or the storage failed, or objects are lost; those
            fetched before remain as files.
        NotFound, Busy, Cancelled
    """
    inner = folder.resolve() / INNER
    with alone(inner):
        if not check_marker(inner, settings):
            raise UsageError("the photos of this library are in its folder already", where=str(folder))
        storage = connect(settings)
        if storage is None or settings.database is None:  # the settings agree with the marker here
            raise UsageError("the address of the database is needed", where="EXPMAP_DATABASE")
        check_owner(inner, storage)
        with closing(Database(settings.database)) as database, database.moving() as connection:
            check_alone(connection)
            files = _bring_all(folder.resolve(), progress=progress)
            address = read_marker(inner)[0]
            (inner / MARKER).rename(inner / f"{MARKER}-until-{now():%Y%m%dT%H%M%S}")
    return ObjectsMoved(files, f"{folder}; copies remain in {address}")


def _bring_all(folder: Path, *, progress: Progress) -> int:
    """Fetch all objects as files; lost ones are reported at the end, after all others were fetched."""
    paths = sorted(pointed_files(folder))
    progress.size(len(paths))
    lost: list[Path] = []
    with ThreadPoolExecutor(_TOGETHER) as pool:
        for start in range(0, len(paths), _SOME):
            progress.check()
            some = paths[start : start + _SOME]
            for path, is_here in zip(some, pool.map(_bring, some), strict=True):
                progress.advance()
                if not is_here:
                    lost.append(path)
    if lost:
        raise StorageError(
            f"{len(lost)} files are lost; all others are in the folder now",
            where=str(lost[0].relative_to(folder)),
            hint="restore them from a backup, or delete .NAME.object next to where they should be",
        )
    return len(paths)


def _bring(path: Path) -> bool:
    """Fetch an object as a file; return False if the storage has lost it."""
    try:
        bring_back(path)
    except ObjectLost:
        return False
    return True
