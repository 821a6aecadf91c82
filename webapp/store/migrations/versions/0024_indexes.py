"""Indexes for the next edit to undo, and for jobs that have ended recently."""

from alembic import op

revision = "0024"
down_revision = "0023"


def upgrade() -> None:
    """Create the new ones first: dropping one locks the table in PostgreSQL until the transaction ends."""
    op.create_index(
        "ix_edit_map_id_edit_account_id_edit_state_edit_id", "edit", ["map_id", "account_id", "state", "id"]
    )
    op.create_index("ix_job_ended_at", "job", ["ended_at"])
    op.drop_index("ix_edit_map_id_edit_account_id_edit_state", "edit")
