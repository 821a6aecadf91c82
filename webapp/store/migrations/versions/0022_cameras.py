"""Which camera a photo was taken with."""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"


def upgrade() -> None:
    """Add the column; it is not known of photos that are there already."""
    op.add_column("photo", sa.Column("camera", sa.String(), nullable=True))
