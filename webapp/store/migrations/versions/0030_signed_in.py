"""Browsers that are signed in, so that people see where and can end each."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0030"
down_revision = "0029"


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "signed_in",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("account_id", sa.Integer(), nullable=False),
        sa.Column("id_hash", sa.String(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("device", sa.String(), nullable=False),
        sa.Column("begun_at", UtcDateTime(), nullable=False),
        sa.Column("used_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_signed_in_account_id", ondelete="CASCADE"
        ),
        sa.UniqueConstraint("id_hash", name="uq_signed_in_id_hash"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_signed_in_account_id", "signed_in", ["account_id"])
