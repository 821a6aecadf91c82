"""What requests about missions share: the mission, parts of addresses, a limit of how many run at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

from flask import current_app
from flask.blueprints import BlueprintSetupState
from werkzeug.routing import BaseConverter

from webapp.errors import NotFound, TooMany
from webapp.missions.render.export_file import FORMATS
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.store.maps.maps import Role
from webapp.web.context import account, library
from webapp.web.state import KEY, AppState

PATH_PARAMETERS: dict[str, dict[str, Any]] = {
    "mission_id": {"description": "Id of the mission."},
    "object_id": {"description": "Id of the object, as the robot gave it."},
    "track_id": {"description": "Id of the track."},
    "ending": {"description": "Format.", "schema": {"type": "string", "enum": list(FORMATS)}},
}

_EXTENSION = "expmap_concurrency"
_WAIT_S = 1


def open_mission(id: int, role: Role = "viewer", *, binned: bool = False) -> Mission:
    """Find a mission that the caller may use in a role, as `open_map` finds maps.

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


class AnyText(BaseConverter):
    """Any text at the end of an address, with slashes too; of rules with `merge_slashes=False`."""

    regex = ".+"
    part_isolating = False


def allow_any_text(setup: BlueprintSetupState) -> None:
    """Let the addresses of a blueprint use these; for `blueprint.record`, before its first address."""
    setup.app.url_map.converters["text"] = AnyText


class ConcurrencyLimit:
    """Limits one kind of request to a share of the threads, so that others are answered too.

    Parameters
    ----------
    name : str
        Of the kind of request.
    share : float
        Of the threads of a process.
    """

    def __init__(self, name: str, *, share: float) -> None:
        self._name = name
        self._share = share

    def set_up(self, setup: BlueprintSetupState) -> None:
        """Make the semaphore of an application; for `blueprint.record`."""
        state = cast(AppState, setup.app.extensions[KEY])
        most = max(1, int(state.settings.serve.threads * self._share))
        setup.app.extensions.setdefault(_EXTENSION, {})[self._name] = threading.BoundedSemaphore(most)

    def semaphore(self) -> threading.BoundedSemaphore:
        """Return the semaphore: one permit for each further request."""
        return cast(threading.BoundedSemaphore, current_app.extensions[_EXTENSION][self._name])

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Hold one permit for as long as the block lasts.

        Raises
        ------
        TooMany
            None is free.
        """
        free = self.semaphore()
        if not free.acquire(blocking=False):
            raise TooMany("the server is busy", wait_s=_WAIT_S, hint="repeat the request a little later")
        try:
            yield
        finally:
            free.release()
