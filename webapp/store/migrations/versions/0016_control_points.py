"""Control points of maps: where they are, and in which photos they are clicked."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    """Add the column."""
    op.add_column("map", sa.Column("control_points", sa.JSON(), nullable=True))
