"""People sign in by an OpenID Connect provider, whose groups give roles."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0036"
down_revision = "0035"


def upgrade() -> None:
    """Add identities, the table of groups, the roles given by it, and sessions that began at a provider."""
    op.create_table(
        "sign_in_identity",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("account_id", sa.Integer(), nullable=True),
        sa.Column("issuer", sa.String(), nullable=False),
        sa.Column("subject", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("email", sa.String(), nullable=True),
        sa.Column("gave_library", sa.Boolean(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("seen_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_sign_in_identity_account_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_sign_in_identity"),
        sa.UniqueConstraint("issuer", "subject", name="uq_sign_in_identity_issuer_subject"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_sign_in_identity_account_id", "sign_in_identity", ["account_id"])
    op.create_table(
        "group_role",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("group_name", sa.String(), nullable=False),
        sa.Column("map_id", sa.Integer(), nullable=True),
        sa.Column("role", sa.String(), nullable=False),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name="fk_group_role_map_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name="pk_group_role"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_group_role_map_id", "group_role", ["map_id"])
    op.create_table(
        "given_role",
        sa.Column("identity_id", sa.Integer(), nullable=False),
        sa.Column("map_id", sa.Integer(), nullable=False),
        sa.Column("role", sa.String(), nullable=False),
        sa.Column("before", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["identity_id"],
            ["sign_in_identity.id"],
            name="fk_given_role_identity_id",
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(["map_id"], ["map.id"], name="fk_given_role_map_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("identity_id", "map_id", name="pk_given_role"),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_given_role_map_id", "given_role", ["map_id"])
    op.create_table(
        "provider_session",
        sa.Column("id_hash", sa.String(), nullable=False),
        sa.Column("identity_id", sa.Integer(), nullable=False),
        sa.Column("id_token", sa.String(), nullable=False),
        sa.Column("at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["identity_id"],
            ["sign_in_identity.id"],
            name="fk_provider_session_identity_id",
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id_hash", name="pk_provider_session"),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_provider_session_identity_id", "provider_session", ["identity_id"])
