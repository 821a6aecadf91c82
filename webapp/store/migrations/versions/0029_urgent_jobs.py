"""Jobs for which somebody waits come before those in the background."""

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"


def upgrade() -> None:
    """Add the column."""
    op.add_column("job", sa.Column("urgent", sa.Boolean(), nullable=False, server_default=sa.false()))
