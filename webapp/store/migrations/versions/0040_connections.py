"""Positions on their way into photo libraries, and photos from visitors whose place is looked for later."""

import sqlalchemy as sa
from alembic import op

revision = "0040"
down_revision = "0039"


def upgrade() -> None:
    """Add the columns."""
    op.add_column("linked_photo", sa.Column("sent_lat", sa.Double(), nullable=True))
    op.add_column("linked_photo", sa.Column("sent_lon", sa.Double(), nullable=True))
    op.add_column(
        "contribution", sa.Column("to_find", sa.Boolean(), nullable=False, server_default=sa.false())
    )
