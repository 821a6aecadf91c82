"""The uncertainty radius of photos that were placed at a suggested position."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    """Add the column."""
    op.add_column("photo", sa.Column("radius_px", sa.Double(), nullable=True))
