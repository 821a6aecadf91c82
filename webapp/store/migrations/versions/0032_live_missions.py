"""People draw search areas, lines and markers on missions; robots say how they are; phones send positions."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0032"
down_revision = "0031"


def upgrade() -> None:
    """Add the tables, the revision of the drawings of a mission, and when its robots count as silent."""
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
    op.add_column("mission", sa.Column("silent_after_s", sa.Double(), nullable=True))
    op.create_table(
        "robot_heard",
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("robot", sa.String(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_robot_heard_mission_id_mission", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "robot", name="pk_robot_heard"),
    )
    op.create_table(
        "robot_status",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("robot", sa.String(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("battery_percent", sa.Double(), nullable=True),
        sa.Column("link_percent", sa.Double(), nullable=True),
        sa.Column("mode", sa.String(), nullable=True),
        sa.Column("text", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_robot_status_mission_id_mission", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_robot_status"),
    )
    op.create_index(
        "ix_robot_status_time_s",
        "robot_status",
        ["mission_id", "robot", "time_s"],
    )
    op.create_table(
        "robot_silence",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("robot", sa.String(), nullable=False),
        sa.Column("since_s", sa.Double(), nullable=False),
        sa.Column("until_s", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_robot_silence_mission_id_mission", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_robot_silence"),
    )
    op.create_index("ix_robot_silence_mission_id", "robot_silence", ["mission_id"])
    op.create_table(
        "mission_phone",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("token_hash", sa.String(), nullable=False),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("heard_at", UtcDateTime(), nullable=True),
        sa.Column("positions", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name="fk_mission_phone_mission_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_mission_phone_account_id", ondelete="SET NULL"
        ),
        sa.UniqueConstraint("token_hash", name="uq_mission_phone_token_hash"),
        sa.UniqueConstraint("mission_id", "name", name="uq_mission_phone_mission_id_name"),
        sqlite_autoincrement=True,
    )
