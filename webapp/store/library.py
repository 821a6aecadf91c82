"""The library: a folder of maps and their database."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from sqlalchemy import Connection, inspect

from webapp.errors import DatabaseUnavailable, StorageError
from webapp.store.database import THREADS, Database
from webapp.store.maps.changing import MapChange, change_map
from webapp.store.moving import marks

_BEFORE_0_7 = ("0001", "0002", "0003", "0004", "0005", "0006")
"""Schemas of versions before 0.7.0, which that version converts."""

INNER = ".library"
"""Folder of everything that is not a map."""

DATABASE = "library.db"
"""Its file in there, where the records are not in a database server."""

SERVER = "database-server"
"""Marks the folder of a library whose records are in one: its address, and the key that it has, too."""

MOVING = "moving.lock"
"""Is held by who moves the records to another database."""

_MIGRATIONS = Path(__file__).parent / "migrations"
_VERSIONS = "alembic_version"
"""The table in which Alembic keeps the version of the others."""

EXPANDED_SINCE = "0022"
"""Migrations after this one only expand: programs with these tables work beside those with the newest.

One that contracts takes away, renames or demands what older programs do not write: then this is raised to
that one, and all machines have to stop. `tests/store/test_rolling.py` distinguishes the two.
"""

_WAIT_S = 120


@dataclass(frozen=True, slots=True)
class Library:
    """Where everything is.

    Attributes
    ----------
    folder : Path
        Absolute; has one folder a map.
    """

    folder: Path
    database: Database

    @property
    def inner(self) -> Path:
        """Everything that is not a map: database, secrets, uploads in progress."""
        return self.folder / INNER

    @property
    def uploads(self) -> Path:
        """Files that have not arrived completely."""
        return self.inner / "uploads"

    def map_folder(self, slug: str) -> Path:
        """Folder of a map, by the slug that the database holds."""
        return self.folder / slug

    def cfg(self, slug: str) -> Path:
        """The map file of a map."""
        return self.map_folder(slug) / "map.cfg"

    @contextmanager
    def changing(self, map_id: int) -> Iterator[MapChange]:
        """Change a map as one transaction: the unit of work of every edit.

        At the end of the block the change is on disk, in the database, together with the job that updates
        the index where photos came onto the map or left it. The files of the map follow: the worker writes
        them within `settings.jobs.export_s` seconds, after a restart too, and who gives them out calls
        `tasks.maps.export.export_map` before.

        Raises
        ------
        NotFound
            The map does not exist.
        StorageError
            The database cannot be written; nothing has changed.
        """
        with self.database.write(locks_rows=True) as session, change_map(session, map_id) as change:
            yield change


def has_library(folder: Path) -> bool:
    """Return whether a folder has a library."""
    return any((folder / INNER / name).is_file() for name in (DATABASE, SERVER))


def open_library(folder: Path, *, url: str | None = None, threads: int = THREADS) -> Library:
    """Open a library, making folder and database where there are none, and bringing an older one up to date.

    Parameters
    ----------
    url : str or None
        Of the database, instead of a SQLite file in the folder.
    threads : int
        Of this process that use it at once.

    Raises
    ------
    StorageError
        The folder cannot be written, the database is damaged, was emptied or cannot be reached, or the folder
        and the database are not of one library.
    UsageError, MissingPart
        As for `Database`.
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
    """Make or check folder and database; errors as `open_library`."""
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
    """Refuse to make new tables next to maps, where a database was cut to nothing, as by a full disk."""
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
    """Refuse to begin a second set of records next to the files of a library on a server."""
    marker = library.inner / SERVER
    if marker.is_file():
        raise StorageError(
            "the records of this library are in a database server",
            where=str(library.folder),
            hint=f"set EXPMAP_DATABASE: {server_address(marker)}; or move them back to SQLite: "
            "expmap library move --to sqlite",
        )


def _check_not_moving(library: Library) -> None:
    """Refuse while the records are on their way to another database."""
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
    """Refuse a database that the records have left, and one that they have not come to completely."""
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
    """Migrate the database of a server, if the folder has the files of the library in it, or both are new."""
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
    if key is None:  # before the tables: killed in between, the next start makes them
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
    """Read where the records of a library are, without the password, from the file `SERVER` in its folder."""
    return marker.read_text("utf-8").partition("\n")[0]


def _marker_key(marker: Path) -> str | None:
    """Read the key of the library in a folder; None of one that an older version has made."""
    lines = marker.read_text("utf-8").splitlines() if marker.is_file() else []
    return lines[1] if len(lines) > 1 else None


def _database_key(database: Database) -> str | None:
    """Read the key of the library in a database; None as for `_marker_key`."""
    with database.translated_errors(), database.engine.connect() as connection:
        return marks.library_key(connection)


def _give_key(database: Database, key: str) -> str:
    """Give a database the key, if none has come first; returns the one that it has."""
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
    """Return whether a library was begun in a database; errors as `schema_version`."""
    return schema_version(database) is not None


def newest_schema() -> str:
    """Return the version of the tables that this program makes."""
    return max(_known())


def schema_version(database: Database) -> str | None:
    """Return the version of the tables of a database; None where it has none.

    Raises
    ------
    StorageError
        The database cannot hold a library, or cannot be reached.
    """
    with (
        database.translated_errors(),
        database.engine.connect() as connection,
        database.backend.migration(connection),
    ):
        return _version(connection)


def _version(connection: Connection) -> str | None:
    """Read what Alembic keeps, without Alembic: loading it takes longer than opening a library."""
    if not inspect(connection).has_table(_VERSIONS):
        return None
    version: str | None = connection.exec_driver_sql(f"SELECT version_num FROM {_VERSIONS}").scalar()
    return version


def migrate(database: Database) -> None:
    """Bring a database of version 0.7.0 or later to the newest schema; make all tables in an empty one.

    Newer tables stay as they are, where they have those of this program and only more: others with a newer
    program work beside it, while machines are updated one after the other.

    Raises
    ------
    StorageError
        An older version has made it, which 0.7.0 converts; or a newer one than this.
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
    """Return the versions of the tables that this program knows."""
    return {path.name.partition("_")[0] for path in (_MIGRATIONS / "versions").glob("*.py")}


def _upgrade(database: Database, connection: Connection) -> None:
    """Run the migrations that are missing; errors as `migrate`."""
    from alembic import command  # only where there is something to do: it takes long to load
    from alembic.config import Config
    from alembic.util.exc import CommandError

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, "head")
        database.backend.note_expanded(connection, EXPANDED_SINCE)
        connection.commit()
    except CommandError as error:
        raise StorageError(
            "a newer version of the program has made this library", hint="update the program"
        ) from error
