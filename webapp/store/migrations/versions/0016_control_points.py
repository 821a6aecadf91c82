"""Control points of maps: their positions, and their clicks in photos."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    """Add the column."""
    op.add_column("map", sa.Column("control_points", sa.JSON(), nullable=True))
