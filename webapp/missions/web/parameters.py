"""Parts of the addresses of missions, as the OpenAPI document describes them."""

from __future__ import annotations

from typing import Any

from webapp.missions.render.export_file import FORMATS

PATH_PARAMETERS: dict[str, dict[str, Any]] = {
    "mission_id": {"description": "Id of the mission."},
    "object_id": {"description": "Id of the object, as the robot gave it."},
    "track_id": {"description": "Id of the track."},
    "ending": {"description": "Format.", "schema": {"type": "string", "enum": list(FORMATS)}},
}
