"""Deletes missions in the bin permanently, block by block, so that others can write in between."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager

from sqlalchemy import delete, select, tuple_
from sqlalchemy.orm import Session

from webapp.errors import Conflict
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, ObjectSighting, Pose, Track, TrackPiece, TrackProfile
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.schema import Job

_BLOCK = 50_000
"""Maximum number of poses or sightings in one transaction."""

Write = Callable[[], AbstractContextManager[Session]]


def queue(session: Session, mission: Mission, *, account_id: int) -> Job:
    """Queue the deletion of a mission, which hides it at once.

    Args:
        session: Session of a write transaction.
        account_id: Account that requested it.

    Raises:
        Conflict: The mission is not in the bin.
    """
    _check(mission)
    return jobs.enqueue(
        session,
        missions.DELETE_JOB,
        account_id=account_id,
        arguments={"mission": mission.id},
        key=str(mission.id),
    )


def delete_mission(library: Library, mission_id: int, *, write: Write, progress: Progress) -> None:
    """Delete a mission: poses and sightings block by block, then its other records, then its files.

    If interrupted, the mission stays in the bin with shorter tracks, and can be deleted again.

    Args:
        mission_id: The mission may be deleted already.
        write: Opens a write transaction.
        progress: One step per pose.

    Raises:
        Conflict: The mission is not in the bin.
        StorageError: Writing failed.
        Cancelled
    """
    with library.database.read() as session:
        progress.size(missions.counts(session, mission_id)[0])
    while (count := _delete_some(mission_id, write)) is not None:
        progress.advance(count)
        progress.check()
    shutil.rmtree(missions.folder(library, mission_id), ignore_errors=True)


def sweep(library: Library, _settings: Settings) -> None:
    """Delete leftover folders of deleted missions; ids are never reused."""
    folders = [path for path in (library.folder / missions.FOLDER).glob("*") if path.name.isdecimal()]
    with library.database.read() as session:
        known = set(session.scalars(select(Mission.id)))
    for folder in folders:
        if int(folder.name) not in known:
            shutil.rmtree(folder, ignore_errors=True)


def _delete_some(mission_id: int, write: Write) -> int | None:
    """Delete a block; return its number of poses, or None when nothing is left."""
    with write() as session:
        mission = session.get(Mission, mission_id, with_for_update=True)
        if mission is None:
            return None
        _check(mission)
        track = session.scalars(select(Track).where(Track.mission_id == mission_id).limit(1)).first()
        if track is not None:
            return _shorten(session, track)
        sighting = (ObjectSighting.object_id, ObjectSighting.number)
        mine = ObjectSighting.mission_id == mission_id
        some = select(*sighting).where(mine).limit(_BLOCK)
        done = session.execute(delete(ObjectSighting).where(mine, tuple_(*sighting).in_(some)), **_BULK)
        if not done.rowcount:  # type: ignore[attr-defined]
            session.delete(mission)
    return 0


_BULK = {"execution_options": {"synchronize_session": False}}


def _shorten(session: Session, track: Track) -> int:
    """Delete the last poses of a track, and the track when none is left; return their number."""
    before, first = track.poses, max(track.poses - _BLOCK, 0)
    session.execute(delete(Pose).where(Pose.track_id == track.id, Pose.number >= first), **_BULK)
    for table in (TrackPiece, TrackProfile):
        session.execute(delete(table).where(table.track_id == track.id), **_BULK)
    track.poses, track.built_to = first, 0
    if not first:
        session.delete(track)
    return before - first


def _check(mission: Mission) -> None:
    if mission.binned_at is None:
        raise Conflict(
            "only missions in the bin can be deleted",
            where=f"mission {mission.id}",
            hint="put it there first",
        )
