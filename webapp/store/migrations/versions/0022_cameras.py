"""The camera with which a photo was taken."""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"


def upgrade() -> None:
    """Add the column; it is unknown for existing photos."""
    op.add_column("photo", sa.Column("camera", sa.String(), nullable=True))
