"""Jobs that wait for something unavailable: the earliest time of the next try, and the number of waits."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"


def upgrade() -> None:
    """Add the columns; running processes of the previous version ignore them."""
    op.add_column("job", sa.Column("not_before", sa.DateTime(), nullable=True))
    op.add_column("job", sa.Column("waits", sa.Integer(), nullable=False, server_default="0"))
