"""The source of a photo: service, author and licence."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """Add the column."""
    op.add_column("photo", sa.Column("source", sa.JSON(), nullable=True))
