"""Brings the database to the newest schema (Alembic)."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.util.exc import CommandError

from webapp.errors import StorageError
from webapp.store.database import Database


def migrate(database: Database) -> None:
    """Bring a database to the newest schema; one that is there already stays as it is.

    Raises
    ------
    StorageError
        A newer version of the program has made it.
    """
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        try:
            command.upgrade(config, "head")
        except CommandError as error:
            raise StorageError(
                "a newer version of the program has made this library", hint="update the program"
            ) from error
