"""The task list: the state of each object, and who set it when."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Add the state of objects, and the table of its changes."""
    op.add_column("mission_object", sa.Column("state", sa.String(), nullable=False, server_default="found"))
    op.add_column("mission_object", sa.Column("state_by", sa.String(), nullable=True))
    op.add_column("mission_object", sa.Column("state_time_s", sa.Double(), nullable=True))
    op.create_table(
        "object_change",
        sa.Column(
            "mission_id",
            sa.Integer(),
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("object_id", sa.String(), primary_key=True),
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("by", sa.String(), nullable=False),
        sa.Column("note", sa.String(), nullable=False),
    )
