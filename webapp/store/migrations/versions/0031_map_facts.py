"""The owner says what a map is; photos added from answers calibrate it, unless it is set not to."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"


def upgrade() -> None:
    """Add the columns."""
    with op.batch_alter_table("map") as table:
        table.add_column(sa.Column("description", sa.String(), nullable=True))
        table.add_column(sa.Column("uses_adopted", sa.Boolean(), nullable=False, server_default=sa.true()))
