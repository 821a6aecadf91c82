"""The mission that a request is about; what addresses of missions are made of, for OpenAPI."""

from __future__ import annotations

from typing import Any

from webapp.errors import NotFound
from webapp.missions.render.export_file import FORMATS
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.store.maps.maps import Role
from webapp.web.context import account, library

PATH_PARAMETERS: dict[str, dict[str, Any]] = {
    "mission_id": {"description": "Id of the mission."},
    "object_id": {"description": "Id of the object, as the robot gave it."},
    "track_id": {"description": "Id of the track."},
    "ending": {"description": "Format.", "schema": {"type": "string", "enum": list(FORMATS)}},
}


def open_mission(id: int, role: Role = "viewer", *, binned: bool = False) -> Mission:
    """Find a mission that who asks may use in a role.

    Parameters
    ----------
    role : str
        That is needed: `viewer`, `editor` or `owner`.
    binned : bool
        Whether a mission in the bin counts.

    Returns
    -------
    Mission
        Of a session that is closed: for reading its fields.

    Raises
    ------
    NotSignedIn, NotFound, NotAllowed
    """
    who = account()
    with library().database.read() as session:
        mission = missions.find(session, id, account=who, role=role)
    if mission.binned_at is not None and not binned:
        raise NotFound(
            "this mission is in the bin", where=f"mission {id}", hint="restore it from the bin first"
        )
    return mission
