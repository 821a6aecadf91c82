"""The photo id reserved for an upload."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Add the column."""
    op.add_column("upload", sa.Column("photo_id", sa.Integer(), nullable=True))
