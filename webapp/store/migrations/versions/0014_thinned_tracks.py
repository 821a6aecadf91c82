"""Thinned tracks: number of removed poses and error, and missions that are exempt."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the columns; nothing has been thinned yet."""
    op.add_column("mission", sa.Column("keep", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.add_column("track", sa.Column("removed", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("track", sa.Column("thinned_m", sa.Double(), nullable=True))
    op.add_column("track", sa.Column("thinned_poses", sa.Integer(), nullable=False, server_default="0"))
