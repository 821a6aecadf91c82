"""The library: a folder of maps and their database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.util.exc import CommandError
from filelock import FileLock, Timeout

from webapp.errors import StorageError
from webapp.store.database import Database, translated_errors
from webapp.store.maps.changing import MapChange, change_map

_BEFORE_0_7 = ("0001", "0002", "0003", "0004", "0005", "0006")
"""Schemas of versions before 0.7.0, which that version converts."""

INNER = ".library"
"""Folder of everything that is not a map."""

DATABASE = "library.db"
"""Its file in there."""

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
        with self.database.write() as session, change_map(session, map_id) as change:
            yield change


def open_library(folder: Path, *, url: str | None = None) -> Library:
    """Open a library, making folder and database where there are none, and bringing an older one up to date.

    Parameters
    ----------
    url : str or None
        Of the database, instead of a SQLite file in the folder.

    Raises
    ------
    StorageError
        The folder cannot be written, or the database is damaged or was emptied.
    """
    folder = folder.resolve()
    library = Library(folder, Database(url or f"sqlite:///{folder / INNER / DATABASE}"))
    try:
        library.uploads.mkdir(parents=True, exist_ok=True)
        with FileLock(library.inner / "migrate.lock", timeout=_WAIT_S):
            if url is None:
                _check_not_emptied(library)
            migrate(library.database)
    except (OSError, Timeout) as error:
        raise StorageError(
            f"the library cannot be opened: {error}",
            where=str(folder),
            hint="check the permissions of the folder",
        ) from error
    return library


def _check_not_emptied(library: Library) -> None:
    """Refuse to make new tables next to maps, where a database was cut to nothing, as by a full disk."""
    file = library.inner / DATABASE
    emptied = file.exists() and file.stat().st_size == 0
    if emptied and any(path.is_dir() and path.name != INNER for path in library.folder.iterdir()):
        raise StorageError(
            "the database is empty, but the folder has maps",
            where=str(file),
            hint="restore a backup (expmap restore), or delete the file to begin a new library here",
        )


def migrate(database: Database) -> None:
    """Bring a database of version 0.7.0 or later to the newest schema; make all tables in an empty one.

    Raises
    ------
    StorageError
        An older version has made it, which 0.7.0 converts; or a newer one than this.
    """
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    with translated_errors(database.url), database.engine.connect() as connection:
        there = MigrationContext.configure(connection).get_current_revision()
        connection.rollback()
        if there in _BEFORE_0_7:
            raise StorageError(
                "this library was made by a version before 0.7.0",
                hint="make a backup, open the library once with version 0.7.0 (expmap serve), which converts "
                "it, and then with this version",
            )
        config.attributes["connection"] = connection
        try:
            command.upgrade(config, "head")
        except CommandError as error:
            raise StorageError(
                "a newer version of the program has made this library", hint="update the program"
            ) from error
