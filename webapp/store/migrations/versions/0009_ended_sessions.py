"""Sessions that were signed out, kept for as long as their cookies would be valid."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "ended_session",
        sa.Column("id_hash", sa.String(), primary_key=True),
        sa.Column("at", UtcDateTime(), nullable=False),
    )
