"""Missions: tracks with poses, objects that were seen, photos and shares."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Make the tables."""
    _missions()
    _tracks()
    _display()
    _objects()
    _arrivals()


def _missions() -> None:
    """Make missions and who may see them without a sign-in."""
    op.create_table(
        "mission",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("map_id", sa.Integer(), nullable=True),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("changed_at", UtcDateTime(), nullable=False),
        sa.Column("binned_at", UtcDateTime(), nullable=True),
        sa.Column("start", sa.JSON(), nullable=True),
        sa.Column("note", sa.String(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("ended_at", UtcDateTime(), nullable=True),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name=op.f("fk_mission_account_id"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name=op.f("fk_mission_map_id"), ondelete="SET NULL"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_mission")),
        sqlite_autoincrement=True,
    )
    with op.batch_alter_table("mission", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_mission_account_id"), ["account_id"], unique=False)
        batch_op.create_index(batch_op.f("ix_mission_map_id"), ["map_id"], unique=False)

    op.create_table(
        "mission_share",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("token_hash", sa.String(), nullable=False),
        sa.Column("public_token", sa.String(), nullable=True),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("photos", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name=op.f("fk_mission_share_account_id"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_share_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_mission_share")),
        sa.UniqueConstraint("token_hash", name=op.f("uq_mission_share_token_hash")),
    )
    with op.batch_alter_table("mission_share", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_mission_share_mission_id"), ["mission_id"], unique=False)


def _tracks() -> None:
    """Make tracks and poses."""
    op.create_table(
        "track",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mission_id", sa.Integer(), nullable=False),
        sa.Column("source", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("poses", sa.Integer(), nullable=False),
        sa.Column("skipped", sa.Integer(), nullable=False),
        sa.Column("distance_m", sa.Double(), nullable=False),
        sa.Column("first_time_s", sa.Double(), nullable=True),
        sa.Column("last_time_s", sa.Double(), nullable=True),
        sa.Column("min_lat", sa.Double(), nullable=True),
        sa.Column("max_lat", sa.Double(), nullable=True),
        sa.Column("min_lon", sa.Double(), nullable=True),
        sa.Column("max_lon", sa.Double(), nullable=True),
        sa.Column("built_to", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_track_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_track")),
        sa.UniqueConstraint("mission_id", "source", "name", name=op.f("uq_track_mission_id_source_name")),
        sqlite_autoincrement=True,
    )

    op.create_table(
        "pose",
        sa.Column("track_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double(), nullable=True),
        sa.Column("heading_deg", sa.Double(), nullable=True),
        sa.Column("var_e", sa.Double(), nullable=True),
        sa.Column("var_n", sa.Double(), nullable=True),
        sa.Column("cov_en", sa.Double(), nullable=True),
        sa.Column("travelled_m", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["track_id"], ["track.id"], name=op.f("fk_pose_track_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("track_id", "number", name=op.f("pk_pose")),
        sqlite_with_rowid=False,
    )


def _display() -> None:
    """Make what tracks are shown by."""
    op.create_table(
        "track_piece",
        sa.Column("track_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("level", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("chunk", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("first_number", sa.Integer(), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        sa.Column("min_lat", sa.Double(), nullable=False),
        sa.Column("max_lat", sa.Double(), nullable=False),
        sa.Column("min_lon", sa.Double(), nullable=False),
        sa.Column("max_lon", sa.Double(), nullable=False),
        sa.Column("first_time_s", sa.Double(), nullable=False),
        sa.Column("last_time_s", sa.Double(), nullable=False),
        sa.Column("points", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["track_id"], ["track.id"], name=op.f("fk_track_piece_track_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("track_id", "level", "chunk", name=op.f("pk_track_piece")),
    )

    op.create_table(
        "track_profile",
        sa.Column("track_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("chunk", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("points", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["track_id"], ["track.id"], name=op.f("fk_track_profile_track_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("track_id", "chunk", name=op.f("pk_track_profile")),
    )


def _objects() -> None:
    """Make what was seen."""
    op.create_table(
        "mission_object",
        sa.Column("mission_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("object_id", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("first_time_s", sa.Double(), nullable=False),
        sa.Column("last_time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double(), nullable=True),
        sa.Column("confidence", sa.Double(), nullable=True),
        sa.Column("photo_sha", sa.String(), nullable=True),
        sa.Column("sightings", sa.Integer(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_object_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "object_id", name=op.f("pk_mission_object")),
    )
    with op.batch_alter_table("mission_object", schema=None) as batch_op:
        batch_op.create_index(
            batch_op.f("ix_mission_object_mission_id_mission_object_kind"),
            ["mission_id", "kind"],
            unique=False,
        )
        batch_op.create_index(
            batch_op.f("ix_mission_object_mission_id_mission_object_revision"),
            ["mission_id", "revision"],
            unique=False,
        )

    op.create_table(
        "sighting",
        sa.Column("mission_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("object_id", sa.String(), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double(), nullable=True),
        sa.Column("confidence", sa.Double(), nullable=True),
        sa.Column("photo_sha", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_sighting_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "object_id", "number", name=op.f("pk_sighting")),
    )


def _arrivals() -> None:
    """Make what is known of senders, and photos."""
    op.create_table(
        "mission_sender",
        sa.Column("mission_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("sender", sa.String(), nullable=False),
        sa.Column("next_seq", sa.Integer(), nullable=False),
        sa.Column("seen_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_sender_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "sender", name=op.f("pk_mission_sender")),
    )

    op.create_table(
        "mission_batch",
        sa.Column("mission_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("key", sa.String(), nullable=False),
        sa.Column("answer", sa.JSON(), nullable=False),
        sa.Column("at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_batch_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "key", name=op.f("pk_mission_batch")),
    )
    with op.batch_alter_table("mission_batch", schema=None) as batch_op:
        batch_op.create_index(
            batch_op.f("ix_mission_batch_mission_id_mission_batch_at"), ["mission_id", "at"], unique=False
        )

    op.create_table(
        "mission_photo",
        sa.Column("mission_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("sha256", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("path", sa.String(), nullable=False),
        sa.Column("width", sa.Integer(), nullable=False),
        sa.Column("height", sa.Integer(), nullable=False),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=True),
        sa.Column("object_id", sa.String(), nullable=True),
        sa.Column("fix", sa.JSON(), nullable=True),
        sa.Column("fix_state", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_photo_mission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", "sha256", name=op.f("pk_mission_photo")),
    )
