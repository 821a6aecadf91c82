"""Photos that were added from answers calibrate a map, unless it is set not to use them."""

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"


def upgrade() -> None:
    """Add the column."""
    op.add_column("map", sa.Column("uses_adopted", sa.Boolean(), nullable=False, server_default=sa.true()))
