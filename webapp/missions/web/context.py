"""Helpers for requests about missions: access to the mission, and path parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flask.blueprints import BlueprintSetupState
from werkzeug.routing import BaseConverter

from webapp.errors import NotFound
from webapp.missions.render.export_file import FORMATS
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.store.maps.maps import Role
from webapp.web.context import View, account, authorized_by, library

PATH_PARAMETERS: dict[str, dict[str, Any]] = {
    "drawing_id": {"description": "Id of the drawing."},
    "file_id": {"description": "Id of the file that was sent."},
    "mission_id": {"description": "Id of the mission."},
    "object_id": {"description": "Id of the object, as the robot gave it."},
    "track_id": {"description": "Id of the track."},
    "ending": {"description": "Format.", "schema": {"type": "string", "enum": list(FORMATS)}},
}


def open_mission(id: int, role: Role = "viewer", *, binned: bool = False) -> Mission:
    """Find a mission that the caller may use in a role, as `open_map` finds maps.

    Raises NotSignedIn, NotFound, NotAllowed.
    """
    who = account()
    with library().database.read() as session:
        mission = missions.find(session, id, account=who, role=role)
    if mission.binned_at is not None and not binned:
        raise NotFound(
            "this mission is in the bin", where=f"mission {id}", hint="restore it from the bin first"
        )
    return mission


def mission_role(role: Role) -> Callable[[View], View]:
    """Have the caller's role on the mission of the URL checked before the body is read."""
    return authorized_by(lambda mission_id, **_: open_mission(mission_id, role))


class AnyText(BaseConverter):
    """Any text at the end of a URL, including slashes; for rules with `merge_slashes=False`."""

    regex = ".+"
    part_isolating = False


def allow_any_text(setup: BlueprintSetupState) -> None:
    """Register the converter `text` for a blueprint; call by `blueprint.record` before its first route."""
    setup.app.url_map.converters["text"] = AnyText
