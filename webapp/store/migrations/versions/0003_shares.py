"""Views that are open without a sign-in, and questions that are known when they come again."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Make the table, and the key of a question."""
    op.add_column("query", sa.Column("key", sa.String(), nullable=True))
    op.create_index("uq_query_key", "query", ["map_id", "account_id", "key"], unique=True)

    op.create_table(
        "share",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("map_id", sa.Integer(), nullable=False),
        sa.Column("query_id", sa.Integer(), nullable=True),
        sa.Column("token_hash", sa.String(), nullable=False),
        sa.Column("public_token", sa.String(), nullable=True),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("photos", sa.Boolean(), nullable=False),
        sa.Column("localize", sa.Boolean(), nullable=False),
        sa.Column("originals", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name=op.f("fk_share_account_id"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name=op.f("fk_share_map_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(
            ["query_id"], ["query.id"], name=op.f("fk_share_query_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_share")),
        sa.UniqueConstraint("token_hash", name=op.f("uq_share_token_hash")),
    )
    with op.batch_alter_table("share", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_share_map_id"), ["map_id"], unique=False)
