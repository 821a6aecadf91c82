"""Blurred photos, those of deleted maps and photos of answers are found by the content of their files."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"


def upgrade() -> None:
    """Add all three; the hash of the photo of an existing answer is computed when it is needed."""
    blurred = sa.text("blurred IS NOT NULL")
    op.create_index(
        "ix_photo_blurred_sha256", "photo", ["sha256"], sqlite_where=blurred, postgresql_where=blurred
    )
    op.create_table(
        "blurred_file",
        sa.Column("sha256", sa.String(), nullable=False),
        sa.Column("boxes", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name="pk_blurred_file"),
        sqlite_with_rowid=False,
    )
    op.add_column("query", sa.Column("sha256", sa.String(), nullable=True))
