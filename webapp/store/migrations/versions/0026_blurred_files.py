"""Blurred photos are found by the content of their files, and so are the photos of answers."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"


def upgrade() -> None:
    """Add the index, and the column; existing answers get no hash, it is computed when it is needed."""
    blurred = sa.text("blurred IS NOT NULL")
    op.create_index(
        "ix_photo_blurred_sha256", "photo", ["sha256"], sqlite_where=blurred, postgresql_where=blurred
    )
    op.add_column("query", sa.Column("sha256", sa.String(), nullable=True))
