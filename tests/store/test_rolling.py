"""Rolling updates: programs of two versions on one database."""

import ast
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import text

from webapp.errors import StorageError
from webapp.store import library as store_library
from webapp.store.library import EXPANDED_SINCE, migrate, newest_schema, open_library, schema_version

_EXPANDING = {"create_table", "create_index", "drop_index", "add_column", "batch_alter_table", "get_bind"}


@pytest.fixture
def newer(library):
    """Upgrade the tables as a newer version with an additional column would."""

    def make(*, since):
        database = library.database
        with database.engine.begin() as connection:
            connection.execute(text("ALTER TABLE map ADD COLUMN of_the_next_version INTEGER"))
            connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
            database.backend.note_expanded(connection, since)

    return make


@pytest.mark.usefixtures("postgresql_only")
def test_an_older_program_works_beside_a_newer_one(library, database_url, newer, new_account, new_map):
    newer(since=newest_schema())
    again = open_library(library.folder, url=database_url)
    ana = new_account("ana", is_owner=True)
    with again.changing(new_map(ana, photos=2)) as change:
        change.record.name = "Forest"
    with again.database.read() as session:
        assert session.execute(text("SELECT name, of_the_next_version FROM map")).one() == ("Forest", None)
    assert schema_version(again.database) == "9999"
    with again.database.engine.connect() as connection:
        assert again.database.backend.expanded_since(connection) == newest_schema(), "kept"
    again.database.close()


def test_an_older_program_is_refused_where_something_was_taken_away(library, database_url, newer):
    newer(since="9998")
    with pytest.raises(StorageError, match="newer version") as refused:
        open_library(library.folder, url=database_url)
    assert refused.value.hint == "update the program"


@pytest.mark.usefixtures("postgresql_only")
def test_what_works_beside_the_tables_is_kept_with_them(library):
    with library.database.engine.connect() as connection:
        assert library.database.backend.expanded_since(connection) == EXPANDED_SINCE


@pytest.fixture
def older(library):
    """The tables as the version before had made them: without the newest one's columns and tables."""
    config = Config()
    config.set_main_option("script_location", str(Path(store_library.__file__).parent / "migrations"))
    with library.database.engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
        config.attributes["connection"] = connection
        command.upgrade(config, "0030")
    return library.database


@pytest.mark.usefixtures("postgresql_only")
def test_a_migration_gives_way_to_those_who_use_a_table_for_long(older, monkeypatch):
    monkeypatch.setattr(store_library, "_PAUSE_S", (0.1, 0.2))
    with older.engine.connect() as backup, ThreadPoolExecutor(1) as pool:
        backup.execute(text("SELECT name FROM map"))
        migrating = pool.submit(migrate, older)
        waited = []
        for _ in range(10):
            begin = time.monotonic()
            with older.engine.connect() as other:
                other.execute(text("SELECT name FROM map"))
            waited.append(time.monotonic() - begin)
            time.sleep(0.2)
        assert max(waited) < 1.8 and not migrating.done()
        backup.rollback()
        migrating.result(timeout=20)
    assert schema_version(older) == newest_schema()
    with older.engine.connect() as connection:
        assert connection.execute(text("SHOW lock_timeout")).scalar_one() == "30s"


@pytest.mark.usefixtures("postgresql_only")
def test_a_migration_that_never_gets_the_tables_changes_nothing_and_says_so(older, monkeypatch):
    monkeypatch.setattr(store_library, "_GIVES_WAY_S", 0)
    with older.engine.connect() as backup:
        backup.execute(text("SELECT name FROM map"))
        with pytest.raises(StorageError, match="others have been using them") as refused:
            migrate(older)
        assert "backups" in refused.value.hint
    assert schema_version(older) == "0030"


def test_migrations_that_count_as_expanding_only_expand():
    script = ScriptDirectory(str(Path(store_library.__file__).parent / "migrations"))
    later = [one for one in script.walk_revisions() if one.revision > EXPANDED_SINCE]
    assert script.get_revision(EXPANDED_SINCE) is not None
    for one in later:
        check_expanding(Path(one.path).read_text("utf-8"))


def check_expanding(source):
    """Check that a migration adds only what older programs need not write."""
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        if not isinstance(call.func, ast.Attribute):
            continue
        owner, name = call.func.value, call.func.attr
        if isinstance(owner, ast.Name) and owner.id in ("op", "batch"):
            assert name in _EXPANDING, name
        if name == "drop_index":
            assert ast.unparse(call.args[0]).startswith("'ix_"), "older programs rely on what is unique"
        if name == "add_column":
            column = ast.unparse(call)
            assert "nullable=True" in column or "server_default" in column, column


def test_what_contracts_is_noticed():
    check_expanding("op.add_column('map', sa.Column('x', sa.Integer(), nullable=True))")
    for text_ in (
        "op.drop_column('map', 'x')",
        "batch.alter_column('x', nullable=False)",
        "op.add_column('map', sa.Column('x', sa.Integer(), nullable=False))",
    ):
        with pytest.raises(AssertionError):
            check_expanding(text_)
