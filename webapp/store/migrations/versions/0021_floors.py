"""Floors of maps, and the floor of each photo."""

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"


def upgrade() -> None:
    """Add the columns; all photos are on the floor of the map's own image."""
    op.add_column("map", sa.Column("floors", sa.JSON(), nullable=True))
    op.add_column("photo", sa.Column("floor", sa.Integer(), nullable=False, server_default="0"))
