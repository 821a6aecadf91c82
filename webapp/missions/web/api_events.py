"""Missions that are followed live: server-sent events."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import String
from apiflask.validators import Length
from flask import Response, request

from webapp.missions.store.schema import Mission
from webapp.missions.web.context import open_mission
from webapp.missions.web.events import event, revision_of
from webapp.missions.web.state import read_cursor
from webapp.store.database import Database
from webapp.web.context import library, settings
from webapp.web.openapi import file_answer
from webapp.web.turns import Turns

blueprint = APIBlueprint("api_mission_events", __name__, url_prefix="/api/v1/missions", tag="Missions")

_SHARE = 0.25
_RETRY_MS = 1000
_ALIVE_S = 10.0
_MOST_CURSOR = 4000

_turns = Turns("events", share=_SHARE)
blueprint.record(_turns.set_up)


class EventsQuery(Schema):
    """What is known already."""

    cursor = String(
        load_default=None,
        validate=Length(max=_MOST_CURSOR),
        metadata={"description": "Of the state of the mission; `Last-Event-ID` goes before it."},
    )


@blueprint.get("/<int(max=2147483647):mission_id>/events")
@blueprint.input(EventsQuery, location="query", arg_name="query")
@blueprint.doc(
    description="Each event `changed` tells `revision`, `ended_at`, `photos` (how many), `tracks` (the "
    "changed ones as in the state, with their `new` points) and `objects` (the changed ones). Its id is a "
    "cursor. The stream ends after a while, or at once where many are open: an `EventSource` comes back by "
    "itself.",
    responses=file_answer("Server-sent events.", "text/event-stream"),
)
def events(mission_id: int, query: dict[str, Any]) -> Response:
    """Follow a mission."""
    mission = open_mission(mission_id)
    known = request.headers.get("Last-Event-ID") or query["cursor"]
    free = _turns.free()
    stays = free.acquire(blocking=False)
    limits = settings().missions
    told = _Told(library().database, mission.id, known)
    stream = _stream(told, seconds=limits.stream_s if stays else 0.0, look_s=limits.look_s)
    response = Response(stream, mimetype="text/event-stream")
    response.headers["X-Accel-Buffering"] = "no"  # nginx would keep events back
    response.headers["Cache-Control"] = "no-store"
    if stays:
        response.call_on_close(_once(free.release))
    return response


class _Told:
    """Where a follower of a mission is."""

    def __init__(self, database: Database, mission_id: int, known: str | None) -> None:
        self._database = database
        self._mission_id = mission_id
        self._known = known

    @property
    def _revision(self) -> int | None:
        cursor = None if self._known is None else read_cursor(self._known)
        return None if cursor is None else cursor[0]

    def next(self) -> str | None:
        """Give the next event; an empty text when nothing is new, None when the mission is gone."""
        with self._database.read() as session:
            revision = revision_of(session, self._mission_id)
            if revision is None or revision == self._revision:
                return None if revision is None else ""
            mission = session.get_one(Mission, self._mission_id)
            text, self._known = event(session, mission, known=self._known)
        return text


def _stream(told: _Told, *, seconds: float, look_s: float) -> Iterator[str]:
    yield f"retry: {_RETRY_MS}\n\n"
    end = time.monotonic() + seconds
    alive = time.monotonic()
    while True:
        text = told.next()
        if text is None:
            return
        if text or time.monotonic() - alive > _ALIVE_S:
            alive = time.monotonic()
            yield text or ":\n\n"  # a comment: whoever has gone away is noticed
        if time.monotonic() + look_s > end:
            return
        time.sleep(look_s)


def _once(run: Callable[[], None]) -> Callable[[], None]:
    """Make a function that runs another one when it is called first, and then no more."""
    lock = threading.Lock()

    def first() -> None:
        if lock.acquire(blocking=False):
            run()

    return first
