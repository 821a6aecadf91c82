"""People set how a track of a mission looks."""

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"


def upgrade() -> None:
    """Add the look of a track, and when it last changed."""
    op.add_column("track", sa.Column("look", sa.JSON(), nullable=True))
    op.add_column("track", sa.Column("look_revision", sa.Integer(), nullable=False, server_default="0"))
