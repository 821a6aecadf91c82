"""What is new of a mission since a moment that its cursor names: for pages that follow it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from webapp.missions.store import missions, tracks
from webapp.missions.store import objects as mission_objects
from webapp.missions.store.schema import Mission, Track
from webapp.missions.tasks.build_pieces import table_of
from webapp.missions.web.api_objects import object_json
from webapp.missions.web.api_tracks import points_json
from webapp.missions.web.state import cursor, read_cursor, track_json

_MOST_POINTS = 500
"""New poses of a track in one event: of more, only some are told."""

_MOST_OBJECTS = 2000
"""Changed objects in one event; the others are told by the next."""

_AGAIN = 200
"""Whoever does not say what is known is told so many of the last poses: they may have come since the page was
made."""


def revision_of(session: Session, mission_id: int) -> int | None:
    """Tell the revision of a mission; None when it is gone."""
    mission = session.get(Mission, mission_id)
    return None if mission is None or mission.binned_at is not None else mission.revision


def event(session: Session, mission: Mission, *, known: str | None) -> tuple[str, str]:
    """Make an event of all that is new.

    Parameters
    ----------
    session : Session
    mission : Mission
    known : str or None
        A cursor; None or another text where nothing is said of what is known.

    Returns
    -------
    str
        The event as it is sent.
    str
        The cursor after it.
    """
    before = None if known is None else read_cursor(known)
    revision, counts = before or (mission.revision, {})
    found = tracks.listed(session, mission.id)
    objects, until = mission_objects.changed(session, mission.id, since=revision, most=_MOST_OBJECTS)
    after = cursor(mission.revision if until is None else until, {track.id: track.poses for track in found})
    data = {
        "revision": mission.revision,
        "ended_at": None if mission.ended_at is None else mission.ended_at.isoformat(timespec="seconds"),
        "photos": missions.counts(session, mission.id)[2],
        "tracks": [
            _track(session, track, known=counts.get(track.id, 0 if before else track.poses - _AGAIN))
            for track in found
            if before is None or counts.get(track.id) != track.poses
        ],
        "objects": [object_json(row) for row in objects],
    }
    return _sent(data, after), after


def _track(session: Session, track: Track, *, known: int) -> dict[str, Any]:
    """Tell of a track, and its poses from the number `known` on."""
    first = min(max(known, 0), track.poses)
    count = track.poses - first
    if count <= _MOST_POINTS:
        points = table_of(tracks.read(session, track, first=first), first=first)
    else:
        numbers = np.linspace(first, track.poses - 1, _MOST_POINTS).astype(np.int64)
        points = table_of(tracks.at(session, track, numbers.tolist()), first=0)
        points[:, 0] = numbers
    return {**track_json(session, track), "new": points_json(points)}


def _sent(data: dict[str, Any], id: str) -> str:
    return f"id: {id}\nevent: changed\ndata: {json.dumps(data, separators=(',', ':'))}\n\n"
