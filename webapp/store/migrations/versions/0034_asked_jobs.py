"""Jobs know when a photo was sent that cannot be localized before they are done."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0034"
down_revision = "0033"


def upgrade() -> None:
    """Add the column."""
    op.add_column("job", sa.Column("asked_at", UtcDateTime(), nullable=True))
