"""Reads a mission for exports, in parts, so that memory use does not depend on its size.

Each part has its own session: downloads can be slow, and a long transaction prevents the database from
cleaning up. Poses added after the start are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.errors import Conflict, NotFound
from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.store import drawings, tracks
from webapp.missions.store.schema import Mission, MissionDrawing, MissionObject, Track
from webapp.store.database import Database

_PART = 4096
_AT_ONCE = 500
"""Maximum number of pose numbers in one statement."""

MOST_KINDS = 200
"""Maximum number of object classes with their own symbols."""


def read(
    database: Database, mission_id: int, *, most: int | None = None, people: bool = False
) -> MissionExport:
    """Read a mission.

    Args:
        most: Maximum number of poses of each track, evenly spread, including the first and the last.
        people: Include the names of people who have set the states of objects, and what concerns people in
            drawings.

    Returns:
        Its functions read from the database when they are called; they raise `Conflict` if a track was
            rewritten in the meantime, so that no truncated file looks complete.

    Raises:
        NotFound: The mission does not exist.
    """
    with database.read() as session:
        mission = session.get(Mission, mission_id)
        if mission is None:
            raise NotFound("mission not found", hint="it may have been deleted: reload the page")
        found = [track for track in tracks.list_tracks(session, mission_id) if track.poses]
        return MissionExport(
            name=mission.name,
            tracks=tuple(_track(database, track, most=most) for track in found),
            kinds=_kinds(session, mission_id),
            objects=partial(_objects, database, mission_id, people=people),
            drawings=tuple(
                _drawing(row, people=people) for row in drawings.list_drawings(session, mission_id)
            ),
        )


def some_objects(
    session: Session, mission_id: int, *, since: int = -1, limit: int, offset: int = 0
) -> list[MissionObject]:
    """Read some objects of a mission, ordered by id.

    Args:
        since: Only those that changed after that revision of the mission.
        limit, offset: Maximum number, and number to skip.
    """
    found = select(MissionObject).where(
        MissionObject.mission_id == mission_id, MissionObject.revision > since
    )
    return list(session.scalars(found.order_by(MissionObject.object_id).limit(limit).offset(offset)))


def find_objects(
    session: Session,
    mission_id: int,
    *,
    within: Sequence[ColumnElement[bool]],
    after: str | None,
    most: int,
) -> tuple[list[MissionObject], int]:
    """Read objects that meet conditions, ordered by id.

    Args:
        after: Only those with a larger id; None for all.
        most: Maximum number.

    Returns:
        The objects, and the number of all that meet the conditions.
    """
    conditions = [MissionObject.mission_id == mission_id, *within]
    count = session.scalar(select(func.count()).select_from(MissionObject).where(*conditions)) or 0
    later = [] if after is None else [MissionObject.object_id > after]
    found = select(MissionObject).where(*conditions, *later).order_by(MissionObject.object_id)
    return list(session.scalars(found.limit(most))), count


def _track(database: Database, track: Track, *, most: int | None) -> ExportTrack:
    bounds = None
    south, west, north, east = track.min_lat, track.min_lon, track.max_lat, track.max_lon
    if south is not None and west is not None and north is not None and east is not None:
        bounds = (south, west, north, east)
    numbers = None
    if most is not None and track.poses > most:
        numbers = np.unique(np.linspace(0, track.poses - 1, most).round().astype(np.int64))
    return ExportTrack(
        id=track.id,
        source=track.source,
        name=track.name,
        count=track.poses if numbers is None else len(numbers),
        distance_m=track.distance_m,
        bounds=bounds,
        poses=partial(_all, database, track)
        if numbers is None
        else partial(_some, database, track, numbers=numbers),
        timed=track.timed,
        removed=track.removed,
        thinned_m=track.thinned_m,
        look=tracks.look_of(track),
        first_time_s=track.first_time_s if track.timed else None,
        last_time_s=track.last_time_s if track.timed else None,
    )


def _all(database: Database, track: Track) -> Iterator[Poses]:
    for first in range(0, track.poses, _PART):
        stop = min(first + _PART, track.poses)
        with database.read() as session:
            part = tracks.read(session, track, first=first, stop=stop)
        yield _complete(part, stop - first)


def _some(database: Database, track: Track, *, numbers: NDArray[np.int64]) -> Iterator[Poses]:
    """Read poses by their numbers, which is an index lookup however long the track is."""
    for first in range(0, len(numbers), _AT_ONCE):
        wanted = numbers[first : first + _AT_ONCE].tolist()
        with database.read() as session:
            part = tracks.at(session, track, wanted)
        yield _complete(part, len(wanted))


def _complete(part: Poses, count: int) -> Poses:
    if len(part) != count:
        raise Conflict("the track changed while it was read", hint="start again")
    return part


def _kinds(session: Session, mission_id: int) -> tuple[str, ...]:
    kinds = select(MissionObject.kind).where(MissionObject.mission_id == mission_id).distinct()
    return tuple(session.scalars(kinds.order_by(MissionObject.kind).limit(MOST_KINDS)))


def _objects(database: Database, mission_id: int, *, people: bool) -> Iterator[ExportObject]:
    after = None
    while True:
        wanted = select(MissionObject).where(MissionObject.mission_id == mission_id)
        if after is not None:
            wanted = wanted.where(MissionObject.object_id > after)
        with database.read() as session:
            part = list(session.scalars(wanted.order_by(MissionObject.object_id).limit(_PART)))
        yield from (as_exported(row, people=people) for row in part)
        if len(part) < _PART:
            return
        after = part[-1].object_id


def as_exported(row: MissionObject, *, people: bool) -> ExportObject:
    """Convert an object; `people` as for `read`."""
    return ExportObject(
        id=row.object_id,
        kind=row.kind,
        latlon=LatLon(row.lat, row.lon),
        first_time_s=row.first_time_s,
        last_time_s=row.last_time_s,
        height_m=row.height_m,
        confidence=row.confidence,
        sightings=row.sightings,
        photo=row.photo_sha,
        covariance_m2=row.covariance_m2,
        size_m=row.size_m,
        state=row.state,
        state_by=row.state_by if people else None,
        state_time_s=row.state_time_s,
    )


def _drawing(row: MissionDrawing, *, people: bool) -> ExportDrawing:
    return ExportDrawing(
        id=row.id,
        kind=row.kind,  # type: ignore[arg-type]
        name=row.name,
        points=tuple(LatLon(*point) for point in drawings.points_of(row)),
        created_time_s=row.created_time_s,
        radius_m=row.radius_m,
        searched_time_s=row.searched_time_s,
        note=row.note if people else "",
        assigned=row.assigned if people else "",
        searched_by=row.searched_by if people else None,
        created_by=row.created_by if people else None,
    )
