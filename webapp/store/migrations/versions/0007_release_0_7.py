"""The tables of version 0.7.0: the oldest schema that is migrated."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0007"
down_revision = None

INT = sa.Integer()


def upgrade() -> None:
    """Create all tables; constraints are named by the convention of `webapp.store.schema`."""
    op.create_table(
        "account",
        sa.Column("id", INT, primary_key=True),
        sa.Column("name", sa.String(), nullable=False, unique=True),
        sa.Column("password_hash", sa.String()),
        sa.Column("is_owner", sa.Boolean(), nullable=False),
        sa.Column("language", sa.String()),
        sa.Column("epoch", INT, nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
    )
    op.create_table(
        "failed_sign_in",
        sa.Column("id", INT, primary_key=True),
        sa.Column("who", sa.String(), nullable=False),
        sa.Column("at", UtcDateTime(), nullable=False),
    )
    op.create_index("ix_failed_sign_in_who_failed_sign_in_at", "failed_sign_in", ["who", "at"])
    op.create_table(
        "map",
        sa.Column("id", INT, primary_key=True),
        sa.Column("slug", sa.String(), nullable=False, unique=True),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("changed_at", UtcDateTime(), nullable=False),
        sa.Column("binned_at", UtcDateTime()),
        sa.Column("revision", INT, nullable=False),
        sa.Column("next_id", INT, nullable=False),
        sa.Column("satellite_path", sa.String()),
        sa.Column("satellite_width", INT),
        sa.Column("satellite_height", INT),
        sa.Column("georeference", sa.JSON()),
        sa.Column("satellite_revision", INT, nullable=False),
        sa.Column("exported_revision", INT, nullable=False),
        sa.Column("exported_sha256", sa.String()),
        sa.Column("previous_sha256", sa.String()),
    )
    op.create_table(
        "api_token",
        sa.Column("id", INT, primary_key=True),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="CASCADE"), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("token_hash", sa.String(), nullable=False, unique=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("used_at", UtcDateTime()),
        sa.UniqueConstraint("account_id", "name"),
    )
    op.create_table(
        "edit",
        sa.Column("id", INT, primary_key=True),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), nullable=False),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("at", UtcDateTime(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("changes", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("turn", INT, nullable=False),
    )
    op.create_index("ix_edit_map_id_edit_account_id_edit_state", "edit", ["map_id", "account_id", "state"])
    op.create_table(
        "job",
        sa.Column("id", INT, primary_key=True),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE")),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("key", sa.String(), nullable=False),
        sa.Column("arguments", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("done", INT, nullable=False),
        sa.Column("total", INT, nullable=False),
        sa.Column("note", sa.String(), nullable=False),
        sa.Column("error", sa.JSON()),
        sa.Column("result", sa.JSON()),
        sa.Column("attempts", INT, nullable=False),
        sa.Column("cancel_wanted", sa.Boolean(), nullable=False),
        sa.Column("fence", INT, nullable=False),
        sa.Column("leased_by", sa.String()),
        sa.Column("leased_until", UtcDateTime()),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("started_at", UtcDateTime()),
        sa.Column("ended_at", UtcDateTime()),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_job_map_id", "job", ["map_id"])
    op.create_index("ix_job_state_job_created_at", "job", ["state", "created_at"])
    op.create_index(
        "uq_job_waiting",
        "job",
        ["map_id", "kind", "key"],
        unique=True,
        sqlite_where=sa.text("state = 'queued'"),
        postgresql_where=sa.text("state = 'queued'"),
    )
    op.create_table(
        "member",
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("role", sa.String(), nullable=False),
    )
    op.create_index("ix_member_account_id", "member", ["account_id"])
    op.create_table(
        "mission",
        sa.Column("id", INT, primary_key=True),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="SET NULL")),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("changed_at", UtcDateTime(), nullable=False),
        sa.Column("binned_at", UtcDateTime()),
        sa.Column("start", sa.JSON()),
        sa.Column("note", sa.String(), nullable=False),
        sa.Column("revision", INT, nullable=False),
        sa.Column("ended_at", UtcDateTime()),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_mission_account_id", "mission", ["account_id"])
    op.create_index("ix_mission_map_id", "mission", ["map_id"])
    op.create_table(
        "photo",
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("id", INT, primary_key=True, autoincrement=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("path", sa.String(), nullable=False),
        sa.Column("sha256", sa.String(), nullable=False),
        sa.Column("size_bytes", INT, nullable=False),
        sa.Column("width", INT, nullable=False),
        sa.Column("height", INT, nullable=False),
        sa.Column("uploaded_at", UtcDateTime(), nullable=False),
        sa.Column("taken_at", sa.String()),
        sa.Column("fov_deg", sa.Double()),
        sa.Column("gps_lat", sa.Double()),
        sa.Column("gps_lon", sa.Double()),
        sa.Column("gps_accuracy_m", sa.Double()),
        sa.Column("gps_problem", sa.String()),
        sa.Column("x_px", sa.Double()),
        sa.Column("y_px", sa.Double()),
        sa.Column("heading_deg", sa.Double()),
        sa.Column("blurred", sa.JSON()),
        sa.Column("removed", sa.Boolean(), nullable=False),
        sa.Column("revision", INT, nullable=False),
        sa.UniqueConstraint("map_id", "sha256"),
    )
    op.create_index("ix_photo_map_id_photo_revision", "photo", ["map_id", "revision"])
    op.create_table(
        "placed_elsewhere",
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("placement", sa.String(), primary_key=True),
        sa.Column("photo_id", INT, primary_key=True, autoincrement=False),
        sa.Column("x_px", sa.Double(), nullable=False),
        sa.Column("y_px", sa.Double(), nullable=False),
    )
    op.create_table(
        "query",
        sa.Column("id", INT, primary_key=True),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), nullable=False),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("at", UtcDateTime(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("file", sa.String(), nullable=False),
        sa.Column("width", INT, nullable=False),
        sa.Column("height", INT, nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("answer", sa.JSON(), nullable=False),
        sa.Column("evidence", sa.JSON(), nullable=False),
        sa.Column("adopted_id", INT),
        sa.Column("key", sa.String()),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_query_map_id_query_id", "query", ["map_id", "id"])
    op.create_index("uq_query_key", "query", ["map_id", "account_id", "key"], unique=True)
    op.create_table(
        "sign_in_link",
        sa.Column("token_hash", sa.String(), primary_key=True),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="CASCADE"), nullable=False),
        sa.Column("expires_at", UtcDateTime(), nullable=False),
        sa.Column("used_at", UtcDateTime()),
    )
    op.create_table(
        "upload",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), nullable=False),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="CASCADE"), nullable=False),
        sa.Column("fingerprint", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("size_bytes", INT, nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.UniqueConstraint("map_id", "account_id", "fingerprint"),
    )
    op.create_index("ix_upload_created_at", "upload", ["created_at"])
    op.create_table(
        "mission_batch",
        sa.Column(
            "mission_id",
            INT,
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("key", sa.String(), primary_key=True),
        sa.Column("answer", sa.JSON(), nullable=False),
        sa.Column("at", UtcDateTime(), nullable=False),
    )
    op.create_index("ix_mission_batch_mission_id_mission_batch_at", "mission_batch", ["mission_id", "at"])
    op.create_table(
        "mission_object",
        sa.Column(
            "mission_id",
            INT,
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("object_id", sa.String(), primary_key=True),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("first_time_s", sa.Double(), nullable=False),
        sa.Column("last_time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double()),
        sa.Column("confidence", sa.Double()),
        sa.Column("photo_sha", sa.String()),
        sa.Column("sightings", INT, nullable=False),
        sa.Column("revision", INT, nullable=False),
    )
    op.create_index(
        "ix_mission_object_mission_id_mission_object_kind", "mission_object", ["mission_id", "kind"]
    )
    op.create_index(
        "ix_mission_object_mission_id_mission_object_revision", "mission_object", ["mission_id", "revision"]
    )
    op.create_table(
        "mission_photo",
        sa.Column(
            "mission_id",
            INT,
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("sha256", sa.String(), primary_key=True),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("path", sa.String(), nullable=False),
        sa.Column("width", INT, nullable=False),
        sa.Column("height", INT, nullable=False),
        sa.Column("size_bytes", INT, nullable=False),
        sa.Column("time_s", sa.Double()),
        sa.Column("object_id", sa.String()),
        sa.Column("fix", sa.JSON()),
        sa.Column("fix_state", sa.String()),
    )
    op.create_table(
        "mission_sender",
        sa.Column(
            "mission_id",
            INT,
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("sender", sa.String(), primary_key=True),
        sa.Column("next_seq", INT, nullable=False),
        sa.Column("seen_at", UtcDateTime(), nullable=False),
    )
    op.create_table(
        "mission_share",
        sa.Column("id", INT, primary_key=True),
        sa.Column("mission_id", INT, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
        sa.Column("token_hash", sa.String(), nullable=False, unique=True),
        sa.Column("public_token", sa.String()),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("photos", sa.Boolean(), nullable=False),
    )
    op.create_index("ix_mission_share_mission_id", "mission_share", ["mission_id"])
    op.create_table(
        "share",
        sa.Column("id", INT, primary_key=True),
        sa.Column("map_id", INT, sa.ForeignKey("map.id", ondelete="CASCADE"), nullable=False),
        sa.Column("query_id", INT, sa.ForeignKey("query.id", ondelete="CASCADE")),
        sa.Column("token_hash", sa.String(), nullable=False, unique=True),
        sa.Column("public_token", sa.String()),
        sa.Column("account_id", INT, sa.ForeignKey("account.id", ondelete="SET NULL")),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("photos", sa.Boolean(), nullable=False),
        sa.Column("localize", sa.Boolean(), nullable=False),
        sa.Column("originals", sa.Boolean(), nullable=False),
    )
    op.create_index("ix_share_map_id", "share", ["map_id"])
    op.create_table(
        "sighting",
        sa.Column(
            "mission_id",
            INT,
            sa.ForeignKey("mission.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("object_id", sa.String(), primary_key=True),
        sa.Column("number", INT, primary_key=True, autoincrement=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double()),
        sa.Column("confidence", sa.Double()),
        sa.Column("photo_sha", sa.String()),
    )
    op.create_table(
        "track",
        sa.Column("id", INT, primary_key=True),
        sa.Column("mission_id", INT, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
        sa.Column("source", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("poses", INT, nullable=False),
        sa.Column("skipped", INT, nullable=False),
        sa.Column("distance_m", sa.Double(), nullable=False),
        sa.Column("first_time_s", sa.Double()),
        sa.Column("last_time_s", sa.Double()),
        sa.Column("min_lat", sa.Double()),
        sa.Column("max_lat", sa.Double()),
        sa.Column("min_lon", sa.Double()),
        sa.Column("max_lon", sa.Double()),
        sa.Column("built_to", INT, nullable=False),
        sa.Column("timed", sa.Boolean(), nullable=False),
        sa.UniqueConstraint("mission_id", "source", "name"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "pose",
        sa.Column(
            "track_id",
            INT,
            sa.ForeignKey("track.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("number", INT, primary_key=True, autoincrement=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("lat", sa.Double(), nullable=False),
        sa.Column("lon", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double()),
        sa.Column("heading_deg", sa.Double()),
        sa.Column("var_e", sa.Double()),
        sa.Column("var_n", sa.Double()),
        sa.Column("cov_en", sa.Double()),
        sa.Column("travelled_m", sa.Double(), nullable=False),
    )
    op.create_table(
        "track_piece",
        sa.Column(
            "track_id",
            INT,
            sa.ForeignKey("track.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("level", INT, primary_key=True, autoincrement=False),
        sa.Column("chunk", INT, primary_key=True, autoincrement=False),
        sa.Column("first_number", INT, nullable=False),
        sa.Column("count", INT, nullable=False),
        sa.Column("min_lat", sa.Double(), nullable=False),
        sa.Column("max_lat", sa.Double(), nullable=False),
        sa.Column("min_lon", sa.Double(), nullable=False),
        sa.Column("max_lon", sa.Double(), nullable=False),
        sa.Column("first_time_s", sa.Double(), nullable=False),
        sa.Column("last_time_s", sa.Double(), nullable=False),
        sa.Column("points", sa.LargeBinary(), nullable=False),
    )
    op.create_table(
        "track_profile",
        sa.Column(
            "track_id",
            INT,
            sa.ForeignKey("track.id", ondelete="CASCADE"),
            primary_key=True,
            autoincrement=False,
        ),
        sa.Column("chunk", INT, primary_key=True, autoincrement=False),
        sa.Column("points", sa.LargeBinary(), nullable=False),
    )
