"""People draw search areas, lines and markers on missions."""

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"


def upgrade() -> None:
    """Add the table, and the revision in which the drawings of a mission last changed."""
    op.add_column("mission", sa.Column("drawings_revision", sa.Integer(), nullable=False, server_default="0"))
    op.create_table(
        "drawing",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("note", sa.String(), nullable=False),
        sa.Column("points", sa.LargeBinary(), nullable=False),
        sa.Column("assigned", sa.String(), nullable=False),
        sa.Column("radius_m", sa.Double(), nullable=True),
        sa.Column("searched_by", sa.String(), nullable=True),
        sa.Column("searched_time_s", sa.Double(), nullable=True),
        sa.Column("created_by", sa.String(), nullable=False),
        sa.Column("created_time_s", sa.Double(), nullable=False),
        sa.Column("changed_by", sa.String(), nullable=False),
        sa.Column("changed_time_s", sa.Double(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_drawing_mission_id_mission", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_drawing"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_drawing_mission_id", "drawing", ["mission_id"])
