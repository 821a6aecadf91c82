"""The library: a folder of maps and their database."""

from __future__ import annotations

import logging
import random
import secrets
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from sqlalchemy import Connection, inspect
from sqlalchemy.exc import DBAPIError

from webapp.errors import DatabaseUnavailable, StorageError
from webapp.store.database import THREADS, Database
from webapp.store.maps.changing import MapChange, change_map
from webapp.store.moving import marks

_log = logging.getLogger(__name__)

_BEFORE_0_7 = ("0001", "0002", "0003", "0004", "0005", "0006")
"""Schema versions before 0.7.0; only that version can convert them."""

INNER = ".library"
"""Folder for all that is not a map."""

DATABASE = "library.db"
"""SQLite file in `INNER`, unless the records are in a database server."""

SERVER = "database-server"
"""File in `INNER` if the records are on a server: its address, and the library's key as in the database."""

MOVING = "moving.lock"
"""Lock file that is held while the records are moved to another database."""

_MIGRATIONS = Path(__file__).parent / "migrations"
_VERSIONS = "alembic_version"
"""Alembic's table with the schema version."""

EXPANDED_SINCE = "0022"
"""Later migrations only expand: programs with this schema work alongside those with the newest.

A contracting migration removes or renames something, or requires what older programs do not write: it must
set this to its own version, and all machines must be stopped. `tests/store/test_rolling.py` checks that.
"""

_WAIT_S = 120
_GIVES_WAY_S = 90
"""Less than others wait for the migration."""
_PAUSE_S = (0.5, 1.5)


@dataclass(frozen=True, slots=True)
class Library:
    folder: Path  # Absolute; has one folder per map
    database: Database

    @property
    def inner(self) -> Path:
        """Folder of all that is not a map: database, secrets, uploads in progress."""
        return self.folder / INNER

    @property
    def uploads(self) -> Path:
        return self.inner / "uploads"

    def map_folder(self, slug: str) -> Path:
        """Return the folder of a map, by its slug in the database."""
        return self.folder / slug

    def cfg(self, slug: str) -> Path:
        return self.map_folder(slug) / "map.cfg"

    @contextmanager
    def changing(self, map_id: int) -> Iterator[MapChange]:
        """Change a map as one transaction: the unit of work of every edit.

        At the end of the block the change is committed to the database, together with the job that updates
        the index if photos came onto the map or left it. The files of the map follow: the worker writes
        them within `settings.jobs.export_s` seconds, also after a restart; code that delivers them calls
        `tasks.maps.export.export_map` first.
        """
        with self.database.write(locks_rows=True) as session, change_map(session, map_id) as change:
            yield change


def has_library(folder: Path) -> bool:
    return any((folder / INNER / name).is_file() for name in (DATABASE, SERVER))


def open_library(folder: Path, *, url: str | None = None, threads: int = THREADS) -> Library:
    """Open a library: create folder and database if missing, and migrate an older database.

    Args:
        url: Of the database; by default it is a SQLite file in the folder.

    Raises:
        StorageError: The folder cannot be written, the database is damaged, was emptied or cannot be reached,
            or the folder and the database belong to different libraries.
        UsageError, MissingPart: As for `Database`.
    """
    folder = folder.resolve()
    there = Database(url or f"sqlite:///{folder / INNER / DATABASE}", threads=threads)
    library = Library(folder, there)
    with ExitStack() as on_failure:
        on_failure.callback(there.close)
        _open(library, is_on_server=url is not None)
        on_failure.pop_all()
    return library


def _open(library: Library, *, is_on_server: bool) -> None:
    """Create or check folder and database; errors as for `open_library`."""
    there = library.database
    try:
        library.uploads.mkdir(parents=True, exist_ok=True)
        with FileLock(library.inner / "migrate.lock", timeout=_WAIT_S):
            _check_not_moving(library)
            if is_on_server:
                _open_on_server(library)
            else:
                _check_not_elsewhere(library)
                _check_not_emptied(library)
                _check_is_here(there)
                migrate(there)
    except DatabaseUnavailable as error:
        reason = str(error.__cause__ or "").strip().splitlines()[:1]
        raise StorageError(
            ": ".join([error.message, *reason]), where=there.name, hint="is it running? See EXPMAP_DATABASE"
        ) from error
    except (OSError, Timeout) as error:
        raise StorageError(
            f"the library cannot be opened: {error}",
            where=str(library.folder),
            hint="check the permissions of the folder",
        ) from error


def _check_not_emptied(library: Library) -> None:
    """Refuse to create tables next to maps if the database was truncated to nothing, as by a full disk."""
    file = library.inner / DATABASE
    emptied = file.exists() and file.stat().st_size == 0
    if emptied and _has_maps(library):
        raise StorageError(
            "the database is empty, but the folder has maps",
            where=str(file),
            hint="restore a backup (expmap restore), or delete the file to begin a new library here",
        )


def _has_maps(library: Library) -> bool:
    return any(path.is_dir() and path.name != INNER for path in library.folder.iterdir())


def _check_not_elsewhere(library: Library) -> None:
    """Refuse to create a SQLite database if the records of the library are in a database server."""
    marker = library.inner / SERVER
    if marker.is_file():
        raise StorageError(
            "the records of this library are in a database server",
            where=str(library.folder),
            hint=f"set EXPMAP_DATABASE: {server_address(marker)}; or move them back to SQLite: "
            "expmap library move --to sqlite",
        )


def _check_not_moving(library: Library) -> None:
    """Refuse to open the library while its records are being moved to another database."""
    lock = library.inner / MOVING
    try:
        if lock.exists():
            FileLock(lock, timeout=0).acquire().lock.release()
    except Timeout as error:
        raise StorageError(
            "the records of this library are being moved to another database",
            where=str(library.folder),
            hint="wait until it has finished",
        ) from error


def _check_is_here(database: Database) -> None:
    """Refuse a database from which the records have moved, or into which their move is incomplete."""
    with database.translated_errors(), database.engine.connect() as connection:
        is_filling = marks.filling_key(connection) is not None
        moved = marks.moved_mark(connection)
    if is_filling:
        raise StorageError(
            "the move of records into this database has not finished",
            where=database.name,
            hint="run the same command again, which completes it",
        )
    if moved is not None:
        raise StorageError(
            f"the records of this library have moved to {moved.place}",
            where=database.name,
            hint="open it there; to go back: expmap library move (docs/cluster.md)",
        )


def _open_on_server(library: Library) -> None:
    """Migrate a database on a server, if it and the folder belong to the same library, or both are new."""
    marker, database = library.inner / SERVER, library.database
    _check_is_here(database)
    if (library.inner / DATABASE).exists():
        raise StorageError(
            "this folder has a library of its own, in SQLite",
            where=str(library.folder),
            hint="move its records to the server: expmap library move --to postgresql; or begin in another "
            "folder, or unset EXPMAP_DATABASE",
        )
    is_new, is_empty = not marker.is_file(), not has_tables(database)
    if _has_maps(library) if is_empty else is_new:
        raise StorageError(
            "this folder is not that of the library in the database",
            where=str(library.folder),
            hint="is it mounted? All machines need the same one; a new library needs an empty folder and an "
            "empty database",
        )
    key, there = _marker_key(marker), _database_key(database)
    if key is None:  # written before the tables: after a crash in between, the next start creates them
        key = there or secrets.token_hex(16)
        part = marker.with_suffix(".part")
        part.write_text(f"{database.name}\n{key}\n", "utf-8")
        part.replace(marker)
    if there in (None, key):
        migrate(database)
        there = there or _give_key(database, key)
    if there != key:
        raise StorageError(
            "the folder and the database are of two libraries",
            where=str(library.folder),
            hint="check EXPMAP_DATABASE and the folder of the library",
        )


def server_address(marker: Path) -> str:
    """Read the address of a library's database server, without the password, from its file `SERVER`."""
    return marker.read_text("utf-8").partition("\n")[0]


def _marker_key(marker: Path) -> str | None:
    """Read the key of the library in a folder; None if it is new, or was made by an older version."""
    lines = marker.read_text("utf-8").splitlines() if marker.is_file() else []
    return lines[1] if len(lines) > 1 else None


def _database_key(database: Database) -> str | None:
    """Read the key of the library in a database; None in the same cases as for `_marker_key`."""
    with database.translated_errors(), database.engine.connect() as connection:
        return marks.library_key(connection)


def _give_key(database: Database, key: str) -> str:
    """Store the key in a database unless it has got one meanwhile; return the one that it has."""
    with (
        database.translated_errors(),
        database.engine.connect() as connection,
        database.backend.migration(connection),
    ):
        there = marks.library_key(connection)
        if there is None:
            marks.set_library_key(connection, key)
            connection.commit()
    return there or key


def has_tables(database: Database) -> bool:
    """Return whether a database has the tables of a library; errors as for `schema_version`."""
    return schema_version(database) is not None


def newest_schema() -> str:
    """Return the schema version that this program creates."""
    return max(_known())


def schema_version(database: Database) -> str | None:
    """Return the schema version of a database; None if it has no tables."""
    with (
        database.translated_errors(),
        database.engine.connect() as connection,
        database.backend.migration(connection),
    ):
        return _version(connection)


def _version(connection: Connection) -> str | None:
    """Read the version without Alembic: importing it takes longer than opening a library."""
    if not inspect(connection).has_table(_VERSIONS):
        return None
    version: str | None = connection.exec_driver_sql(f"SELECT version_num FROM {_VERSIONS}").scalar()
    return version


def migrate(database: Database) -> None:
    """Migrate a database of version 0.7.0 or later to the newest schema; create all tables in an empty one.

    A newer schema that only expands this program's is left as it is: newer programs use it on other machines,
    while these are updated one after the other.

    Raises:
        StorageError: The schema is older than 0.7.0, which can convert it, or newer and incompatible.
    """
    with (
        database.translated_errors(),
        database.engine.connect() as connection,
        database.backend.migration(connection),
    ):
        there = _version(connection)
        connection.rollback()
        if there == newest_schema():
            return
        if there in _BEFORE_0_7:
            raise StorageError(
                "this library was made by a version before 0.7.0",
                hint="make a backup, open the library once with version 0.7.0 (expmap serve), which converts "
                "it, and then with this version",
            )
        if (
            there is not None
            and there not in _known()
            and database.backend.expanded_since(connection) in _known()
        ):
            return
        _upgrade(database, connection)


def _known() -> set[str]:
    """Return the schema versions that this program knows."""
    return {path.name.partition("_")[0] for path in (_MIGRATIONS / "versions").glob("*.py")}


def _upgrade(database: Database, connection: Connection) -> None:
    """Run the missing migrations; errors as for `migrate`.

    Where other programs use a table for long, the migration gives way and tries again: what it waits for is
    what all others would have to wait for, too.
    """
    before, begin = _version(connection), time.monotonic()
    connection.rollback()
    while True:
        try:
            _run_migrations(connection)
            database.backend.note_expanded(connection, EXPANDED_SINCE)
            connection.commit()
            break
        except DBAPIError as error:
            if not database.backend.gave_way(error):
                raise
            connection.rollback()
            if time.monotonic() > begin + _GIVES_WAY_S:
                raise StorageError(
                    f"the tables cannot be migrated: others have been using them for {_GIVES_WAY_S} s",
                    where=database.name,
                    hint="wait until backups and other long work have ended, and start the program again",
                ) from error
            time.sleep(random.uniform(*_PAUSE_S))
    if before is not None:
        seconds = time.monotonic() - begin
        _log.info("the tables were migrated from %s to %s in %.2f s", before, newest_schema(), seconds)


def _run_migrations(connection: Connection) -> None:
    from alembic import command  # imported only when needed, as it takes long
    from alembic.config import Config
    from alembic.util.exc import CommandError

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, "head")
    except CommandError as error:
        raise StorageError(
            "a newer version of the program has made this library", hint="update the program"
        ) from error
