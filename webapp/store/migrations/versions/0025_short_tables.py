"""Tables of short rows become WITHOUT ROWID in SQLite; uploads are too few for an index of their times."""

from alembic import op

revision = "0025"
down_revision = "0024"

_TABLES = ("sign_in_link", "ended_session", "member", "placed_elsewhere")


def upgrade() -> None:
    """Recreate the tables with their rows; PostgreSQL has no such tables."""
    op.drop_index("ix_upload_created_at", "upload")
    connection = op.get_bind()
    if connection.dialect.name == "sqlite":
        for name in _TABLES:
            # rows whose map or account another program has deleted without them could not be inserted again
            orphans = f"SELECT rowid FROM pragma_foreign_key_check('{name}')"
            connection.exec_driver_sql(f"DELETE FROM {name} WHERE rowid IN ({orphans})")
            without_rowid = {"sqlite_with_rowid": False}
            with op.batch_alter_table(name, recreate="always", table_kwargs=without_rowid):
                pass
