"""Jobs that wait for what is away: not before when, and how often in a row."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"


def upgrade() -> None:
    """Add the columns; a process of the version before, which is still at work, leaves them alone."""
    op.add_column("job", sa.Column("not_before", sa.DateTime(), nullable=True))
    op.add_column("job", sa.Column("waits", sa.Integer(), nullable=False, server_default="0"))
