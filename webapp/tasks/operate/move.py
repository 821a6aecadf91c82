"""Moves the records of a library from SQLite to a PostgreSQL server or back, or its files into S3 or back.

Other processes are locked out while records are moved. Once all rows are copied and compared, the old
database is marked as moved, and only then does the folder name the new one: two databases can never be
opened. A killed move leaves the old one in use, or neither, and is completed by running the same command
again. The old database is kept.

Each file is in at least one of folder and object storage at any time: an interrupted move leaves a usable
library, and is continued by running the same command again. No object is deleted.
"""

from __future__ import annotations

import json
import secrets
import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from sqlalchemy import Connection

from webapp.errors import Busy, Conflict, NotFound, ObjectLost, StorageError, UsageError
from webapp.files.atomic import storage_error, sync_folder, write_text
from webapp.files.contents import bring_back, connect
from webapp.files.lock import any_alive
from webapp.files.object_storage.storage import MARKER, check_marker, read_marker
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.database import Database, backend_of
from webapp.store.library import (
    DATABASE,
    INNER,
    MOVING,
    SERVER,
    Library,
    newest_schema,
    schema_version,
    server_address,
)
from webapp.store.moving import marks
from webapp.store.moving.copying import SourceChanged, TableCopy, copy_records, prepare
from webapp.store.moving.marks import MovedMark
from webapp.tasks.operate.maintain_objects import move_locked_photos, objects_lock, pointed_files
from webapp.tasks.operate.open_storage import check_owner, refuse_objects

TICKET = "moving.json"
"""File in `.library` with the key and the target of an incomplete move."""

_PART = f"{DATABASE}.moving"
_WAIT_S, _POLL_S = 5.0, 0.1
"""Seconds to wait for processes that are just ending, and between two checks."""

_IN_USE = Conflict(
    "a server, a worker or a command is using this library", hint="stop them first, on all machines"
)


@dataclass(frozen=True, slots=True)
class MoveReport:
    tables: tuple[TableCopy, ...]  # The copied tables
    place: str  # The new database
    kept: str  # The old database


def move_to_server(folder: Path, url: str, *, progress: Progress) -> MoveReport:
    """Move the records of a library from SQLite to a server.

    Args:
        url: Address of an empty database, or of one that this move has partly filled.

    Raises:
        NotFound: There is no library in the folder.
        UsageError: Its records are in a server already, or the database is not empty.
        Conflict: The library is in use.
        StorageError, DiskFull, MissingPart: One of the databases cannot be read or written, or is of another
            version of the program.
        Cancelled: The library is unchanged.
    """
    inner = folder.resolve() / INNER
    with alone(inner), closing(Database(url)) as target:
        file, marker = inner / DATABASE, inner / SERVER
        if marker.exists() and _ticket(inner, target.name) is None:
            raise UsageError(
                "the records of this library are in a database server already",
                where=str(folder),
                hint=server_address(marker),
            )
        tables: tuple[TableCopy, ...] = ()
        if not marker.exists():
            _join_journal(file)  # raises if another process has it open
            with closing(Database(f"sqlite:///{file}")) as source:
                key = _begin(inner, target.name, source)
                tables = _move(source, target, key=key, progress=progress)
            write_text(marker, f"{target.name}\n")
        kept = _put_aside(file)
        with target.moving() as connection:
            marks.unmark_filling(connection)
        (inner / TICKET).unlink()
    return MoveReport(tables, target.name, str(kept))


def move_to_file(folder: Path, url: str | None, *, progress: Progress) -> MoveReport:
    """Move the records of a library from a server to SQLite.

    Raises:
        NotFound: There is no library in the folder.
        UsageError: Its records are in SQLite already, there is no address, or photos of the library are in
            S3.
    """
    inner = folder.resolve() / INNER
    refuse_objects(inner, doing="a library in SQLite")
    with alone(inner):
        file, marker = inner / DATABASE, inner / SERVER
        if not marker.exists():
            if _ticket(inner, str(file)) is None:
                raise UsageError("the records of this library are in SQLite already", where=str(folder))
            (inner / TICKET).unlink()  # an earlier move was killed just before its end
            return MoveReport((), str(file), "the database in the server")
        if url is None:
            raise UsageError(
                "the address of the database is needed",
                where="EXPMAP_DATABASE",
                hint=f"set it: {server_address(marker)}",
            )
        tables: tuple[TableCopy, ...] = ()
        with closing(Database(url)) as source:
            key = _begin(inner, str(file), source)
            if not file.exists():
                tables = _fill_file(source, file, key=key, progress=progress)
            elif _mark_of(source) is None:  # `_begin` has refused the mark of another move
                raise StorageError("this folder has a library of its own, in SQLite", where=str(folder))
        marker.unlink()  # from now on the SQLite file is opened
        sync_folder(inner)
        (inner / TICKET).unlink()
    return MoveReport(tables, str(file), source.name)


def _fill_file(source: Database, file: Path, *, key: str, progress: Progress) -> tuple[TableCopy, ...]:
    """Write the SQLite file under a temporary name, and rename it when it is complete."""
    part = file.with_name(_PART)
    with (
        closing(Database(f"sqlite:///{part}")) as target,
        target.translated_errors(),
        target.engine.connect() as connection,
    ):
        is_ours = marks.filling_key(connection) == key
    if not is_ours:  # left by an abandoned move, or by one killed between the following steps
        _remove(part)
    with closing(Database(f"sqlite:///{part}")) as target:
        tables = _move(source, target, key=key, place=str(file), progress=progress)
        with target.moving() as connection:
            marks.unmark_filling(connection)
    _join_journal(part)
    part.rename(file)
    sync_folder(file.parent)
    return tables


def _move(
    source: Database, target: Database, *, key: str, place: str | None = None, progress: Progress
) -> tuple[TableCopy, ...]:
    """Copy and compare all records, and mark the old database as moved."""
    if schema_version(source) != newest_schema():
        raise StorageError(
            "the database is of another version of the program",
            where=source.name,
            hint="open the library once with this version (expmap serve), or move it by that one",
        )
    with source.moving() as connection:
        check_alone(connection)
        moved = marks.moved_mark(connection)
        _refuse_other_move(moved, key, name=source.name)
        if marks.filling_key(connection) is not None:
            raise StorageError("the move of records into this database has not finished", where=source.name)
        prepare(target, key=key)
        try:
            tables = copy_records(connection, target, progress=progress)
        except SourceChanged:  # the library was changed after an earlier move was killed
            prepare(target, key=key, again=True)
            tables = copy_records(connection, target, progress=progress)
        if moved is None:
            marks.mark_moved(connection, MovedMark(key, place or target.name))
    return tables


def _mark_of(source: Database) -> MovedMark | None:
    with source.translated_errors(), source.engine.connect() as connection:
        return marks.moved_mark(connection)


def _refuse_other_move(moved: MovedMark | None, key: str | None, *, name: str) -> None:
    """Refuse a database whose records were moved by another move than the one with this key."""
    if moved is not None and moved.key != key:
        raise StorageError(
            f"the records of this library have moved to {moved.place}",
            where=name,
            hint="run the command with that address to complete an interrupted move",
        )


@contextmanager
def alone(inner: Path) -> Iterator[None]:
    """Prevent other processes from opening a library during the block; refuse if one has it open.

    Raises NotFound, Conflict, Busy, StorageError.
    """
    if not any((inner / name).is_file() for name in (DATABASE, SERVER)):
        raise NotFound(
            "there is no library in this folder", where=str(inner.parent), hint="set it: --library FOLDER"
        )
    try:
        with FileLock(inner / MOVING, timeout=_WAIT_S):
            if any_alive(inner / "workers"):
                raise _IN_USE
            yield
    except Timeout as error:
        raise Busy(
            "the records of this library are being moved already",
            wait_s=60,
            hint="wait until it has finished",
        ) from error
    except OSError as error:
        raise storage_error(error, where=str(inner)) from error


def check_alone(connection: Connection) -> None:
    """Refuse if another process on any machine is connected; wait a little for one that is just ending.

    Raises Conflict.
    """
    until = time.monotonic() + _WAIT_S
    while backend_of(connection).is_open_elsewhere(connection):
        if time.monotonic() > until:
            raise _IN_USE
        time.sleep(_POLL_S)


def _begin(inner: Path, place: str, source: Database) -> str:
    """Write the ticket of a move, or find that of a killed one; return its key.

    Raises:
        StorageError: The records were moved to another place, or a move to another place is incomplete.
    """
    key = _ticket(inner, place)
    _refuse_other_move(_mark_of(source), key, name=source.name)
    if key is None:
        key = secrets.token_hex(8)
        write_text(inner / TICKET, json.dumps({"key": key, "place": place}))
    return key


def _ticket(inner: Path, place: str) -> str | None:
    """Return the key of an incomplete move to this place; None if there is none."""
    path = inner / TICKET
    if not path.exists():
        return None
    ticket = json.loads(path.read_text("utf-8"))
    return str(ticket["key"]) if ticket["place"] == place else None


def _put_aside(file: Path) -> Path:
    """Rename the old file, unless a killed move has done so; return its new path."""
    if not file.exists() and (earlier := sorted(file.parent.glob(f"{file.stem}-until-*{file.suffix}"))):
        return earlier[-1]
    kept = file.with_name(f"{file.stem}-until-{now():%Y%m%dT%H%M%S}{file.suffix}")
    if file.exists():
        _join_journal(file)
        file.rename(kept)
        sync_folder(file.parent)
    return kept


def _join_journal(file: Path) -> None:
    """Merge SQLite's journal (WAL) into the database file, so that it can be renamed."""
    try:
        with closing(sqlite3.connect(file, timeout=_WAIT_S)) as database:
            database.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.OperationalError as error:
        raise _IN_USE from error


def _remove(part: Path) -> None:
    for end in ("", "-wal", "-shm"):
        part.with_name(f"{part.name}{end}").unlink(missing_ok=True)


_TOGETHER, _SOME = 4, 32
"""Objects fetched concurrently, and between two checks for cancellation."""

_WORKER_WAIT_S, _CANCEL_POLL_S = 600.0, 1.0
"""Seconds to wait for a worker that moves the same files, and between two checks for cancellation."""


@dataclass(frozen=True, slots=True)
class ObjectsMoved:
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
    lock, until = objects_lock(library), time.monotonic() + _WORKER_WAIT_S
    is_noted = False
    while not lock.is_locked:
        progress.check()
        try:
            lock.acquire(timeout=min(_CANCEL_POLL_S, _WORKER_WAIT_S))
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

    Raises:
        UsageError: The library has no storage.
        Conflict: The library is in use.
        StorageUnavailable, DiskFull, StorageError: The disk or the storage failed, or objects are lost; those
            fetched before remain as files.
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
