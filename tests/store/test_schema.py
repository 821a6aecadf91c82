"""The migrations make just the tables that the program has, from any point on."""

from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from webapp.store.library import open_library
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
