"""Photos have remarks about their files, and uploads the files beside a photo."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"


def upgrade() -> None:
    """Add both; what was uploaded before has none."""
    op.add_column("photo", sa.Column("file_notes", sa.JSON(), nullable=True))
    op.add_column("upload", sa.Column("beside", sa.JSON(), nullable=True))
