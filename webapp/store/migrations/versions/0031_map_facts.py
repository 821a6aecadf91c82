"""The owner says what a map is; photos added from answers calibrate it, unless it is set not to."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"


def upgrade() -> None:
    """Add the columns; a table that is made anew would use ids again."""
    op.add_column("map", sa.Column("description", sa.String(), nullable=True))
    op.add_column("map", sa.Column("uses_adopted", sa.Boolean(), nullable=False, server_default=sa.true()))
