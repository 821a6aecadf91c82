"""The revision that last changed which photos are placed on a map."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Add the column."""
    op.add_column("map", sa.Column("photos_revision", sa.Integer(), nullable=False, server_default="0"))
