"""Whether the times of a track are told by its source."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Add the column."""
    op.add_column("track", sa.Column("timed", sa.Boolean(), nullable=False, server_default=sa.true()))
