"""Panoramas: photos that show the whole sphere, and their masks."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Add the column."""
    op.add_column("photo", sa.Column("panorama", sa.JSON(), nullable=True))
