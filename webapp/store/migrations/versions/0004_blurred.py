"""Parts of photos that are blurred in all pictures of them."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Add the column."""
    op.add_column("photo", sa.Column("blurred", sa.JSON(), nullable=True))
