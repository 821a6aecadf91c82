"""Vectors of photos, for a search in all maps."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Create the tables."""
    op.create_table(
        "vector_basis",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("photos", sa.Integer(), nullable=False),
        sa.Column("ready", sa.Boolean(), nullable=False),
        sa.Column("arrays", sa.LargeBinary(), nullable=False),
    )
    op.create_table(
        "map_vectors",
        sa.Column("map_id", sa.Integer(), sa.ForeignKey("map.id", ondelete="CASCADE"), primary_key=True),
        sa.Column(
            "basis_id", sa.Integer(), sa.ForeignKey("vector_basis.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("version", sa.String(), nullable=False),
        sa.Column("photos", sa.Integer(), nullable=False),
        sa.Column("contents", sa.LargeBinary(), nullable=False),
        sa.Column("vectors", sa.LargeBinary(), nullable=False),
    )
