"""Whether a share shows the map in 3D."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"


def upgrade() -> None:
    """Add the column."""
    op.add_column("share", sa.Column("landmarks", sa.Boolean(), nullable=False, server_default=sa.false()))
