"""Accuracy and size of detections, and whether the server associated them to an object."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"

_MEASURES = ("var_e", "var_n", "cov_en", "size_x_m", "size_y_m", "size_z_m")


def upgrade() -> None:
    """Add the columns, and an index of sightings by time."""
    for table in ("mission_object", "sighting"):
        for name in _MEASURES:
            op.add_column(table, sa.Column(name, sa.Double(), nullable=True))
    op.add_column(
        "mission_object",
        sa.Column("associated", sa.Boolean(), nullable=False, server_default=sa.false()),
    )
    op.create_index("ix_sighting_mission_id_sighting_time_s", "sighting", ["mission_id", "time_s"])
