"""Accounts connect photo libraries, whose albums are parts of maps."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0038"
down_revision = "0037"


def upgrade() -> None:
    """Add libraries, the albums that maps have of them, and their photos."""
    op.create_table(
        "photo_library",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("account_id", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("address", sa.String(), nullable=False),
        sa.Column("sealed_key", sa.String(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_photo_library_account_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_photo_library"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_photo_library_account_id", "photo_library", ["account_id"])
    op.create_table(
        "linked_album",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("library_id", sa.Integer(), nullable=False),
        sa.Column("map_id", sa.Integer(), nullable=False),
        sa.Column("album", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("every_h", sa.Integer(), nullable=False),
        sa.Column("writes_back", sa.Boolean(), nullable=False),
        sa.Column("due_at", UtcDateTime(), nullable=True),
        sa.Column("updated_at", UtcDateTime(), nullable=True),
        sa.Column("error", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["library_id"], ["photo_library.id"], name="fk_linked_album_library_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name="fk_linked_album_map_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name="pk_linked_album"),
        sa.UniqueConstraint("library_id", "album", "map_id", name="uq_linked_album_library_id_album_map_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_linked_album_map_id", "linked_album", ["map_id"])
    op.create_table(
        "linked_photo",
        sa.Column("album_id", sa.Integer(), nullable=False),
        sa.Column("asset", sa.String(), nullable=False),
        sa.Column("checksum", sa.String(), nullable=False),
        sa.Column("photo_id", sa.Integer(), nullable=True),
        sa.Column("lat", sa.Double(), nullable=True),
        sa.Column("lon", sa.Double(), nullable=True),
        sa.Column("written", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("problem", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["album_id"], ["linked_album.id"], name="fk_linked_photo_album_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("album_id", "asset", name="pk_linked_photo"),
        sqlite_with_rowid=False,
    )
