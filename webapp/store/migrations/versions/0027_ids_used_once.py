"""Ids of accounts, maps, tokens and shares are never used again; in PostgreSQL they never were."""

from pathlib import Path

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"

_TABLES = ("account", "map", "api_token", "share", "mission_share")


def upgrade() -> None:
    """Recreate the tables in SQLite, which are small; others refer to them by the same names as before."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        return
    for name in _TABLES:
        with op.batch_alter_table(name, recreate="always", table_kwargs={"sqlite_autoincrement": True}):
            pass
    for name in ("account", "map"):
        _count_from(connection, name, used=max(_named(connection, name), default=0))


def _named(connection: sa.Connection, name: str) -> list[int]:
    """List the greatest ids that other tables name, and accounts that the names of staged files contain."""
    tables = sa.inspect(connection).get_table_names()
    columns = [
        (table, column)
        for table in tables
        for key in sa.inspect(connection).get_foreign_keys(table)
        for column in key["constrained_columns"]
        if key["referred_table"] == name
    ]
    found = [
        connection.exec_driver_sql(f'SELECT coalesce(max("{column}"), 0) FROM "{table}"').scalar_one()
        for table, column in columns
    ]
    if name == "account":
        found += _staging_accounts(connection)
    return found


def _staging_accounts(connection: sa.Connection) -> list[int]:
    """List the accounts of staged files, which may have been removed; the files are next to the database."""
    place = connection.exec_driver_sql(
        "SELECT file FROM pragma_database_list WHERE name = 'main'"
    ).scalar_one()
    parts = [path.name.split(".") for path in Path(place).with_name("uploads").glob("*.*.*.track")]
    return [int(part[1]) for part in parts if part[1].isdecimal()]


def _count_from(connection: sa.Connection, name: str, *, used: int) -> None:
    """Let a table continue after an id that is larger than its own."""
    last = connection.execute(
        sa.text("SELECT seq FROM sqlite_sequence WHERE name = :name"), {"name": name}
    ).scalar()
    if used > (last or 0):
        connection.execute(sa.text("DELETE FROM sqlite_sequence WHERE name = :name"), {"name": name})
        connection.execute(
            sa.text("INSERT INTO sqlite_sequence VALUES (:name, :used)"), {"name": name, "used": used}
        )
