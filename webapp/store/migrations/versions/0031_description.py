"""What a map is, in a sentence of its owner."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"


def upgrade() -> None:
    """Add the column."""
    with op.batch_alter_table("map") as table:
        table.add_column(sa.Column("description", sa.String(), nullable=True))
