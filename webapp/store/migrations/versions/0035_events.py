"""Accounts hear of events by webhooks and e-mail."""

import sqlalchemy as sa
from alembic import op

from webapp.store.clock import UtcDateTime

revision = "0035"
down_revision = "0034"


def upgrade() -> None:
    """Add receivers and deliveries of events, and whether the silence of a robot was noticed."""
    op.add_column("robot_heard", sa.Column("silence_noted_s", sa.Double(), nullable=True))
    op.create_table(
        "event_receiver",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("account_id", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("address", sa.String(), nullable=False),
        sa.Column("events", sa.JSON(), nullable=False),
        sa.Column("salt", sa.String(), nullable=False),
        sa.Column("confirmed_at", UtcDateTime(), nullable=True),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("try_at", UtcDateTime(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["account_id"], ["account.id"], name="fk_event_receiver_account_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_event_receiver"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_event_receiver_account_id", "event_receiver", ["account_id"])
    op.create_table(
        "event_delivery",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("receiver_id", sa.Integer(), nullable=False),
        sa.Column("event_id", sa.String(), nullable=False),
        sa.Column("event", sa.String(), nullable=False),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("at", UtcDateTime(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("tries", sa.Integer(), nullable=False),
        sa.Column("ended_at", UtcDateTime(), nullable=True),
        sa.Column("error", sa.String(), nullable=True),
        sa.ForeignKeyConstraint(
            ["receiver_id"], ["event_receiver.id"], name="fk_event_delivery_receiver_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name="pk_event_delivery"),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_event_delivery_state_event_delivery_receiver_id", "event_delivery", ["state", "receiver_id"]
    )
    op.create_index("ix_event_delivery_receiver_id", "event_delivery", ["receiver_id"])
