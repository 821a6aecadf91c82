"""Live updates of missions as server-sent events."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from apiflask import APIBlueprint, Schema
from apiflask.fields import String
from apiflask.validators import Length
from flask import Response, request
from sqlalchemy.orm import Session

from webapp.errors import DatabaseUnavailable, NotAllowed, NotFound, NotSignedIn
from webapp.missions.store import missions, tracks
from webapp.missions.store import objects as mission_objects
from webapp.missions.store.missions import topic_of
from webapp.missions.store.schema import Mission, Track
from webapp.missions.tasks.track_display import table_of
from webapp.missions.web.api_objects import object_json
from webapp.missions.web.api_tracks import points_json
from webapp.missions.web.context import mission_role, open_mission
from webapp.missions.web.state import cursor, read_cursor, track_json
from webapp.store.backends.watching import Watch
from webapp.store.database import Database
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import library, repeated_check, settings
from webapp.web.openapi import file_answer
from webapp.web.sending import CHECK_S

blueprint = APIBlueprint("api_mission_events", __name__, url_prefix="/api/v1/missions", tag="Missions")

_SHARE = 0.25
_RETRY_MS = 1000
_ALIVE_S = 10.0
_MOST_CURSOR = 4000
_MOST_POINTS = 500
"""Maximum number of new poses of a track in one event; more are subsampled."""

_MOST_OBJECTS = 2000
"""Changed objects in one event; the others follow in the next."""

_AGAIN = 200
"""Number of last poses sent to clients without a cursor, which may have arrived since the page was made."""

_limit = ConcurrencyLimit("events", share=_SHARE)
blueprint.record(_limit.set_up)


class EventsQuery(Schema):
    """The state that the client knows already."""

    cursor = String(
        load_default=None,
        validate=Length(max=_MOST_CURSOR),
        metadata={"description": "Of the state of the mission; `Last-Event-ID` goes before it."},
    )


@blueprint.get("/<id:mission_id>/events")
@mission_role("viewer")
@blueprint.input(EventsQuery, location="query", arg_name="query")
@blueprint.doc(
    description="Each event `changed` has `revision`, `ended_at`, `photos` (how many), `drawings_revision` "
    "(another number: they have changed), `tracks` (the changed ones as in the state, with `new` points), "
    "`track_ids` (of all: others were removed) and `objects` (the changed ones). Its id is a cursor. The "
    "stream ends after a while, or at once where many are open: an `EventSource` reconnects by itself.",
    responses=file_answer("Server-sent events.", "text/event-stream"),
)
def events(mission_id: int, query: dict[str, Any]) -> Response:
    """Follow a mission."""
    mission = open_mission(mission_id)
    known = request.headers.get("Last-Event-ID") or query["cursor"]
    free = _limit.semaphore()
    stays = free.acquire(blocking=False)
    limits = settings().missions
    follower = _Follower(library().database, mission.id, known)
    stream = _stream(follower, seconds=limits.stream_s if stays else 0.0, look_s=limits.look_s)
    response = Response(stream, mimetype="text/event-stream")
    response.headers["X-Accel-Buffering"] = "no"  # prevents nginx from buffering events
    response.headers["Cache-Control"] = "no-store"
    if stays:
        response.call_on_close(_once(free.release))
    return response


class _Follower:
    """A client's position in the event stream of a mission."""

    def __init__(self, database: Database, mission_id: int, known: str | None) -> None:
        self._database = database
        self._check = repeated_check()
        self._check_at = 0.0
        self._mission_id = mission_id
        self._known = known

    def watch(self, *, look_s: float) -> AbstractContextManager[Watch]:
        """Watch the mission for changes."""
        return self._database.watch(topic_of(self._mission_id), look_s=look_s)

    @property
    def _revision(self) -> int | None:
        before = None if self._known is None else read_cursor(self._known)
        return None if before is None else before[0]

    def next(self) -> str | None:
        """Return the next event; an empty string if nothing changed, None if the mission no longer exists.

        Raises:
            NotSignedIn, NotFound, NotAllowed: The client may no longer follow the mission.
        """
        text = self._read()
        if text or time.monotonic() >= self._check_at:
            self._check()  # after reading, so that nothing is sent after the right has ended
            self._check_at = time.monotonic() + CHECK_S
        return text

    def _read(self) -> str | None:
        with self._database.read() as session:
            revision = revision_of(session, self._mission_id)
            if revision is None or revision == self._revision:
                return None if revision is None else ""
            mission = session.get_one(Mission, self._mission_id)
            text, self._known = make_event(session, mission, known=self._known)
        return text


def revision_of(session: Session, mission_id: int) -> int | None:
    """Return the revision of a mission; None if it was deleted or is in the bin."""
    mission = session.get(Mission, mission_id)
    return None if mission is None or mission.binned_at is not None else mission.revision


def make_event(session: Session, mission: Mission, *, known: str | None) -> tuple[str, str]:
    """Return an event with all changes since a cursor.

    Args:
        known: A cursor; None or an invalid one if the client's state is unknown.

    Returns:
        The encoded event.
        The cursor after it.
    """
    before = None if known is None else read_cursor(known)
    revision, counts = before or (mission.revision, {})
    found = tracks.list_tracks(session, mission.id)
    objects, until = mission_objects.changed_since(session, mission.id, since=revision, most=_MOST_OBJECTS)
    after = cursor(mission.revision if until is None else until, {track.id: track.poses for track in found})
    data = {
        "revision": mission.revision,
        "ended_at": None if mission.ended_at is None else mission.ended_at.isoformat(timespec="seconds"),
        "drawings_revision": mission.drawings_revision,
        "photos": missions.counts(session, mission.id)[2],
        "tracks": [
            _track(session, track, known=counts.get(track.id, 0 if before else track.poses - _AGAIN))
            for track in found
            if before is None or counts.get(track.id) != track.poses or track.look_revision > revision
        ],
        "track_ids": [track.id for track in found],
        "objects": [object_json(row) for row in objects],
    }
    return _encoded(data, after), after


def _track(session: Session, track: Track, *, known: int) -> dict[str, Any]:
    """Describe a track, with its poses from the number `known` on."""
    first = min(max(known, 0), track.poses)
    count = track.poses - first
    if count <= _MOST_POINTS:
        points = table_of(tracks.read(session, track, first=first), first=first)
    else:
        numbers = np.linspace(first, track.poses - 1, _MOST_POINTS).astype(np.int64)
        points = table_of(tracks.at(session, track, numbers.tolist()), first=0)
        points[:, 0] = numbers
    return {**track_json(session, track), "new": points_json(points)}


def _encoded(data: dict[str, Any], id: str) -> str:
    return f"id: {id}\nevent: changed\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"


def _stream(follower: _Follower, *, seconds: float, look_s: float) -> Iterator[str]:
    yield f"retry: {_RETRY_MS}\n\n"
    end = time.monotonic() + seconds
    alive = time.monotonic()
    with follower.watch(look_s=look_s) as watch:
        while True:
            try:
                text = follower.next()
            except (
                DatabaseUnavailable,
                NotSignedIn,
                NotFound,
                NotAllowed,
            ):  # the browser reconnects, and then gets the error
                return
            if text is None:
                return
            if text or time.monotonic() - alive >= _ALIVE_S:
                alive = time.monotonic()
                yield text or ":\n\n"  # a comment, to detect closed connections
            left = end - time.monotonic()
            if left < look_s:
                return
            watch.wait(min(left, _ALIVE_S))


def _once(run: Callable[[], None]) -> Callable[[], None]:
    """Wrap a function so that only the first call runs it."""
    lock = threading.Lock()

    def first() -> None:
        if lock.acquire(blocking=False):
            run()

    return first
