"""The library: a folder of maps and the database beside them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.errors import StorageError
from webapp.store.database import Database
from webapp.store.maps.changing import MapChange, change_map
from webapp.store.migrate import migrate

INNER = ".library"
"""Folder of what is no map."""

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
        """What is no map: database, secrets, uploads on their way in."""
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
        them within `settings.jobs.sweep_s` seconds, after a restart too, and who gives them out calls
        `tasks.maps.export.export_map` before.

        Raises
        ------
        NotFound
            There is no such map.
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
        The folder cannot be written.
    """
    folder = folder.resolve()
    library = Library(folder, Database(url or f"sqlite:///{folder / INNER / DATABASE}"))
    try:
        library.uploads.mkdir(parents=True, exist_ok=True)
        with FileLock(library.inner / "migrate.lock", timeout=_WAIT_S):
            migrate(library.database)
    except (OSError, Timeout) as error:
        raise StorageError(
            f"the library cannot be opened: {error}",
            where=str(folder),
            hint="check the permissions of the folder",
        ) from error
    return library
