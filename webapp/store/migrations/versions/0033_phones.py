"""Phones that send positions to a mission by a link of their own."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0033"
down_revision = "0031"


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "mission_phone",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("token_hash", sa.String(), nullable=False),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("heard_at", UtcDateTime(), nullable=True),
        sa.Column("positions", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_mission_phone_mission_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_mission_phone_account_id", ondelete="SET NULL"
        ),
        sa.UniqueConstraint("token_hash", name="uq_mission_phone_token_hash"),
        sa.UniqueConstraint("mission_id", "name", name="uq_mission_phone_mission_id_name"),
        sqlite_autoincrement=True,
    )
