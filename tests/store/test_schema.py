"""The migrations make just the tables that the program has, from any point on."""

import sqlite3
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext

import webapp.missions.store.schema  # noqa: F401  (its tables are part of the database)
import webapp.store
from webapp.store.database import Database
from webapp.store.library import open_library
from webapp.store.migrate import migrate
from webapp.store.schema import Base


def test_the_migrations_make_the_tables(library):
    with library.database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


def test_opening_again_changes_nothing(library, new_account):
    new_account("ana")
    again = open_library(library.folder)
    with again.database.read() as session:
        assert session.connection().exec_driver_sql("SELECT name FROM account").scalars().all() == ["ana"]
    again.database.close()


@pytest.fixture
def older(tmp_path):
    """Make a database as it was at a revision; gives it open."""
    made = []

    def make(revision):
        path = tmp_path / "older.db"
        database = Database(f"sqlite:///{path.as_posix()}")
        made.append(database)
        config = Config()
        folder = Path(webapp.store.__file__).with_name("migrations")
        config.set_main_option("script_location", str(folder))
        with database.engine.connect() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, revision)
        return database, path

    yield make
    for database in made:
        database.close()


def test_jobs_of_an_older_library_stay_and_their_ids_are_not_used_again(older):
    database, path = older("0005")
    add = (
        "INSERT INTO job (kind, key, arguments, state, done, total, note, attempts, cancel_wanted, fence,"
        " created_at) VALUES ('index', ?, '{}', 'queued', 0, 0, '', 0, 0, 0, '2024-05-18 15:00:00')"
    )
    with sqlite3.connect(path) as raw:
        raw.executemany(add, [("a",), ("b",)])
    raw.close()
    migrate(database)
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
    with sqlite3.connect(path) as raw:
        assert raw.execute("SELECT id, key FROM job ORDER BY id").fetchall() == [(1, "a"), (2, "b")]
        raw.execute("DELETE FROM job")
        raw.execute(add, ("c",))
        assert raw.execute("SELECT id FROM job").fetchall() == [(3,)]
        told = raw.execute("SELECT sql FROM sqlite_master WHERE name = 'uq_job_waiting'").fetchone()[0]
        assert "UNIQUE" in told and "WHERE state = 'queued'" in told
    raw.close()
