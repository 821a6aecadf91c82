"""Visitors give photos to shared maps."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0039"
down_revision = "0038"


def upgrade() -> None:
    """Add the permission of shares, and the photos that were given."""
    op.add_column("share", sa.Column("contribute", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.create_table(
        "contribution",
        sa.Column("map_id", sa.Integer(), nullable=False),
        sa.Column("photo_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("share_id", sa.Integer(), nullable=True),
        sa.Column("visitor", sa.String(), nullable=False),
        sa.Column("sent_at", UtcDateTime(), nullable=False),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("x_px", sa.Double(), nullable=True),
        sa.Column("y_px", sa.Double(), nullable=True),
        sa.Column("radius_px", sa.Double(), nullable=True),
        sa.Column("heading_deg", sa.Double(), nullable=True),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.Column("floor", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name="fk_contribution_map_id", ondelete="CASCADE"),
        sa.ForeignKeyConstraint(
            ["share_id"], ["share.id"], name="fk_contribution_share_id", ondelete="SET NULL"
        ),
        sa.PrimaryKeyConstraint("map_id", "photo_id", name="pk_contribution"),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_contribution_share_id", "contribution", ["share_id"])
    op.create_index("ix_contribution_visitor", "contribution", ["visitor"])
