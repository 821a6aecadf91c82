"""Ids of jobs that are never used again."""

from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Make the table anew where it can give the id of a deleted job to a new one."""
    if op.get_bind().dialect.name == "sqlite":
        with op.batch_alter_table("job", recreate="always", table_kwargs={"sqlite_autoincrement": True}):
            pass
