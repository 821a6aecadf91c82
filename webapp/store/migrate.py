"""Brings the database to the newest schema (Alembic)."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.util.exc import CommandError

from webapp.errors import StorageError
from webapp.store.database import Database

_BEFORE_0_7 = ("0001", "0002", "0003", "0004", "0005", "0006")
"""Schemas of versions before 0.7.0, which that version converts."""


def migrate(database: Database) -> None:
    """Bring a database of version 0.7.0 or later to the newest schema; make all tables in an empty one.

    Raises
    ------
    StorageError
        An older version has made it, which 0.7.0 converts; or a newer one than this.
    """
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    with database.engine.connect() as connection:
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
