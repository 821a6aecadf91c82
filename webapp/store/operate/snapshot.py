"""A consistent copy of the database while others read and write it, and the files that it names."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from webapp.errors import DiskFull, StorageError
from webapp.progress import Progress
from webapp.store.database import Database
from webapp.store.moving import marks
from webapp.store.moving.copying import copy_records, prepare


@dataclass(frozen=True, slots=True)
class PartContents:
    """Records of one kind that have their own files."""

    ids: frozenset[int]
    files: frozenset[tuple[int, str]]  # Id of the record and path in its folder


Reader = Callable[[sqlite3.Connection], PartContents]
"""Reads the records of one kind; a database of an older version may lack their tables."""


@dataclass(frozen=True, slots=True)
class SnapshotContents:
    """The contents of a database, and the files that it needs."""

    maps: dict[int, str]  # Slug of each map by its id
    photos: int
    files: frozenset[tuple[str, str]]  # Slug of the map and path in its folder, of all photos and images
    queries: frozenset[tuple[int, str]]  # Id of the map and name of the file, of the photos of all queries
    parts: dict[str, PartContents]  # Further records, by the names of their readers

    def names(self) -> Iterator[str]:
        """Yield all paths, file names and names of map folders."""
        yield from self.maps.values()
        yield from (path for _, path in self.files)
        yield from (file for _, file in self.queries)
        yield from (path for part in self.parts.values() for _, path in part.files)


def copy_to(database: Database, target: Path, *, readers: Mapping[str, Reader]) -> SnapshotContents:
    """Copy a database to a file.

    Args:
        target: Its content is replaced.
    """
    try:
        if database.engine.dialect.name != "sqlite":
            _copy_from_server(database, target)
        with closing(sqlite3.connect(target)) as copy:
            if database.engine.dialect.name == "sqlite":
                with database.engine.connect() as connection:
                    source = connection.connection.driver_connection
                    assert isinstance(source, sqlite3.Connection)
                    source.backup(copy)
            copy.execute("PRAGMA journal_mode=DELETE")  # one file, without journal files
            return _contents(copy, readers)
    except sqlite3.Error as error:
        raise _storage_error(error, target) from error


def _copy_from_server(database: Database, target: Path) -> None:
    """Copy a consistent snapshot of a server's rows to a SQLite database."""
    for end in ("-wal", "-shm"):  # left by a killed process
        target.with_name(f"{target.name}{end}").unlink(missing_ok=True)
    target.write_bytes(b"")
    with closing(Database(f"sqlite:///{target}")) as copy:
        prepare(copy, key="backup")
        with database.read() as session:
            connection = session.connection()
            database.backend.unlimited(connection)
            copy_records(connection, copy, progress=Progress())
        with copy.moving() as written:
            marks.unmark_filling(written)


def check(path: Path, *, readers: Mapping[str, Reader]) -> SnapshotContents:
    """Check a database file for damage, and return its contents."""
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            (found,) = database.execute("PRAGMA integrity_check(1)").fetchone()
            if found != "ok":
                raise StorageError(f"the database is damaged: {found}", where=path.name)
            (programs,) = database.execute(
                "SELECT count(*) FROM sqlite_master WHERE type IN ('trigger', 'view')"
            ).fetchone()
            if programs:
                raise StorageError(
                    "the database has triggers or views, which no library has", where=path.name
                )
            return _contents(database, readers)
    except sqlite3.Error as error:
        raise _storage_error(error, path) from error


def _contents(database: sqlite3.Connection, readers: Mapping[str, Reader]) -> SnapshotContents:
    maps: dict[int, str] = dict(database.execute("SELECT id, slug FROM map"))
    photos = database.execute("SELECT map.slug, path FROM photo JOIN map ON map.id = map_id").fetchall()
    images = database.execute("SELECT slug, satellite_path FROM map WHERE satellite_path IS NOT NULL")
    with_floors = database.execute("SELECT slug, floors FROM map WHERE floors IS NOT NULL")
    plans = [(slug, path) for slug, floors in with_floors for path in _images(floors)]
    queries = database.execute("SELECT map_id, file FROM query")
    files = frozenset([*photos, *images, *plans])
    parts = {name: read(database) for name, read in readers.items()}
    return SnapshotContents(maps, len(photos), files, frozenset(queries), parts)


def _images(floors: str) -> list[str]:
    return [floor["image"]["path"] for floor in json.loads(floors) or () if floor.get("image")]


def _storage_error(error: sqlite3.Error, path: Path) -> StorageError:
    full = getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    hint = "free some space on the disk" if full else None
    return (DiskFull if full else StorageError)(f"the database: {error}", where=path.name, hint=hint)
