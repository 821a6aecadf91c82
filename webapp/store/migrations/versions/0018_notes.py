"""Notes: on photos, on spots of maps, and whether a share shows them."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Add the columns."""
    op.add_column("map", sa.Column("notes", sa.JSON(), nullable=True))
    op.add_column("photo", sa.Column("note", sa.String(), nullable=True))
    op.add_column("share", sa.Column("notes", sa.Boolean(), nullable=False, server_default=sa.false()))
