"""Missions of the library: permissions, and the list of missions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Select, and_, event, func, or_, select
from sqlalchemy.orm import Session

from webapp.core import texts
from webapp.errors import NotAllowed, NotFound, UsageError
from webapp.missions.store.schema import Mission, MissionObject, MissionPhoto, ObjectSighting, Track
from webapp.store.clock import now
from webapp.store.database import announce
from webapp.store.library import Library
from webapp.store.list_parts import ListCursor, ListPart, last_changed_first
from webapp.store.maps import maps
from webapp.store.maps.maps import ROLES, Role
from webapp.store.operate import jobs
from webapp.store.schema import Account, Job, MapRecord, Member

FOLDER = ".missions"
"""Folder in the library with a folder for the files of each mission."""

DELETE_JOB = "mission-delete"
"""Kind of the job that deletes the mission whose id is its key; meanwhile the mission is hidden."""

MOST_SIGHTINGS = 5000
"""Maximum number of sightings of an object in one response; queries have all."""

_MAX_NAME = 120
MAX_NOTE = 10_000

_LAST_CHANGED_FIRST = last_changed_first(Mission.changed_at, Mission.id)
_MOST_PARAMETERS = 10_000


def folder(library: Library, mission_id: int) -> Path:
    """Return the folder of a mission, which is created with its first file."""
    return library.folder / FOLDER / str(mission_id)


def create(
    session: Session,
    name: str,
    *,
    account_id: int,
    map_id: int | None = None,
    start: dict[str, Any] | None = None,
    note: str = "",
) -> Mission:
    """Create a mission without tracks.

    Args:
        account_id: Creator of the mission.
        map_id: Map whose roles apply to the mission; None for no map: it then belongs to the account alone.
        start: `lat`, `lon` and `heading_deg` of the origin of the robot's frame.

    Raises:
        UsageError: The name or the note is invalid.
    """
    mission = Mission(
        name=checked_name(name), account_id=account_id, map_id=map_id, start=start, note=checked_note(note)
    )
    session.add(mission)
    session.flush()
    return mission


def checked_name(name: str) -> str:
    """Validate and normalise the name of a mission. Raises UsageError."""
    tidy = texts.tidy_name(name, most=_MAX_NAME)
    if tidy is None:
        raise UsageError(
            "this is not a valid name for a mission",
            where="name",
            hint=f"give 1 to {_MAX_NAME} printable characters",
        )
    return tidy


def checked_note(note: str) -> str:
    """Validate a note. Raises UsageError."""
    if len(note) > MAX_NOTE or texts.has_controls(note, besides="\n\r\t"):
        raise UsageError(
            "this is not a valid note for a mission",
            where="note",
            hint=f"give at most {MAX_NOTE} printable characters",
        )
    return note


def find(session: Session, id: int, *, account: Account, role: Role = "viewer") -> Mission:
    """Find a mission that an account may use in a role, also in the bin.

    Raises:
        NotFound: The mission does not exist, or is not shared with the account.
        NotAllowed: The account may see the mission, but lacks the role.
    """
    mission = session.get(Mission, id)
    own = None if mission is None else role_of(session, mission, account=account)
    if mission is None or own is None or (mission.binned_at and id in _going(session)):
        raise NotFound("mission not found, or it is not shared with you", where=f"mission {id}")
    if ROLES.index(own) < ROLES.index(role):
        raise NotAllowed(f"this needs the role {role}, and yours is {own}", hint="ask an owner of the map")
    return mission


def role_of(session: Session, mission: Mission, *, account: Account) -> Role | None:
    """Return the role of an account on a mission: that on its map; without a map, its creator is the owner.

    The owner of the library owns every mission.
    """
    record = None if mission.map_id is None else session.get(MapRecord, mission.map_id)
    if record is not None:
        return maps.role_of(session, record, account=account)
    return "owner" if account.is_owner or mission.account_id == account.id else None


def visible(session: Session, account: Account, *, binned: bool = False) -> Select[Any]:
    """Select the ids of the missions that an account may see: those in use, or those in the bin."""
    found = select(Mission.id).where(Mission.binned_at.is_not(None) == binned)
    if binned:
        found = found.where(Mission.id.not_in(_going(session)))
    if not account.is_owner:
        mine = select(Member.map_id).where(Member.account_id == account.id)
        alone = (Mission.account_id == account.id) & Mission.map_id.is_(None)
        found = found.where(or_(Mission.map_id.in_(mine), alone))
    return found


def count_binned(session: Session, account: Account) -> int:
    """Count the missions in the bin that an account may see."""
    ids = visible(session, account, binned=True).subquery()
    return session.scalar(select(func.count()).select_from(ids)) or 0


def _going(session: Session) -> set[int]:
    """List the missions that are being deleted."""
    wanted = select(Job.key).where(Job.kind == DELETE_JOB, Job.state.not_in(jobs.ENDED))
    return {int(key) for key in session.scalars(wanted)}


def topic_of(mission_id: int) -> str:
    """Return the topic that is announced when a mission changes or is deleted."""
    return f"mission {mission_id}"


@event.listens_for(Mission, "after_update")
@event.listens_for(Mission, "after_delete")
def _announce(_mapper: object, connection: Connection, mission: Mission) -> None:
    announce(connection, topic_of(mission.id))


def count_change(mission: Mission) -> None:
    """Count a change of a mission, so that open pages are notified."""
    mission.revision += 1
    mission.changed_at = now()


def end(mission: Mission) -> None:
    """Mark a mission as ended, unless it has ended already."""
    if mission.ended_at is None:
        mission.ended_at = now()


def put_into_bin(mission: Mission) -> None:
    """Move a mission to the bin: it is no longer listed, but nothing is deleted."""
    mission.binned_at = now()


def take_from_bin(mission: Mission) -> None:
    mission.binned_at = None


def counts(session: Session, mission_id: int) -> tuple[int, int, int]:
    """Count the poses, the objects and the photos of a mission."""
    poses = select(func.coalesce(func.sum(Track.poses), 0)).where(Track.mission_id == mission_id)
    objects = select(func.count()).where(MissionObject.mission_id == mission_id)
    photos = select(func.count()).where(MissionPhoto.mission_id == mission_id)
    return tuple(session.scalar(found) or 0 for found in (poses, objects, photos))  # type: ignore[return-value]


def find_object(session: Session, mission_id: int, object_id: str) -> MissionObject:
    """Find an object of a mission. Raises NotFound."""
    found = session.get(MissionObject, (mission_id, object_id))
    if found is None:
        raise NotFound("object not found in the mission", where=object_id)
    return found


def sightings(session: Session, mission_id: int, object_id: str) -> list[ObjectSighting]:
    """List the last `MOST_SIGHTINGS` sightings of an object in order of arrival."""
    mine = (ObjectSighting.mission_id == mission_id, ObjectSighting.object_id == object_id)
    found = select(ObjectSighting).where(*mine).order_by(ObjectSighting.number.desc()).limit(MOST_SIGHTINGS)
    return list(session.scalars(found))[::-1]


def photos(session: Session, mission_id: int) -> list[MissionPhoto]:
    """List the photos of a mission by their time; those without one are last."""
    found = select(MissionPhoto).where(MissionPhoto.mission_id == mission_id)
    by_time = (MissionPhoto.time_s.is_(None), MissionPhoto.time_s, MissionPhoto.sha256)
    return list(session.scalars(found.order_by(*by_time)))


def find_photo(session: Session, mission_id: int, sha256: str) -> MissionPhoto:
    """Find a photo of a mission. Raises NotFound."""
    found = session.get(MissionPhoto, (mission_id, sha256))
    if found is None:
        raise NotFound("photo not found in the mission", where=sha256)
    return found


@dataclass(frozen=True, slots=True)
class Entry:
    mission: Mission
    role: str | None  # Role of the caller
    slug: str | None  # Slug of its map
    tracks: list[Track]  # In order of creation
    objects: int
    photos: int

    @property
    def poses(self) -> int:
        return sum(track.poses for track in self.tracks)

    @property
    def cursor(self) -> ListCursor:
        """Cursor of the entries after this one."""
        return ListCursor(self.mission.changed_at, self.mission.id)


@dataclass(frozen=True, slots=True)
class MissionListPart(ListPart):
    """Filter of the list of missions; the search covers the names of missions and of their maps."""

    map_id: int | None = None  # Only those on that map


_ALL = MissionListPart()


def list_missions(session: Session, account: Account, *, part: MissionListPart = _ALL) -> list[Entry]:
    """List missions that an account may see, the most recently changed first."""
    ids, after = visible(session, account, binned=part.binned), part.after
    if part.map_id is not None:
        ids = ids.where(Mission.map_id == part.map_id)
    if after is not None:
        ids = ids.where(after.follow(Mission.changed_at, Mission.id))
    if part.search.strip():
        some = _searched(session, ids, text=part.search, most=part.limit)
        blocks = (some[begin : begin + _MOST_PARAMETERS] for begin in range(0, len(some), _MOST_PARAMETERS))
        return [entry for block in blocks for entry in _entries(session, account, block)]
    return _entries(session, account, ids.order_by(*_LAST_CHANGED_FIRST).limit(part.limit))


def _searched(session: Session, ids: Select[Any], *, text: str, most: int | None) -> list[int]:
    """Return the ids of missions that a search finds, in the order of the list.

    Names are compared in Python, since databases differ in case folding.
    """
    names = select(Mission.id, Mission.name, MapRecord.name)
    names = names.outerjoin(MapRecord, MapRecord.id == Mission.map_id).where(Mission.id.in_(ids))
    wanted = texts.folded(text)
    rows = session.execute(names.order_by(*_LAST_CHANGED_FIRST))
    found = (id for id, name, map_ in rows if wanted in texts.folded(f"{name} {map_ or ''}"))
    return list(islice(found, most))


def entry(session: Session, mission: Mission, *, account: Account) -> Entry:
    (entry,) = _entries(session, account, select(Mission.id).where(Mission.id == mission.id))
    return entry


def _entries(session: Session, account: Account, ids: Select[Any] | Sequence[int]) -> list[Entry]:
    objects = select(func.count()).where(MissionObject.mission_id == Mission.id).scalar_subquery()
    photos = select(func.count()).where(MissionPhoto.mission_id == Mission.id).scalar_subquery()
    member = and_(Member.map_id == Mission.map_id, Member.account_id == account.id)
    found = select(Mission, Member.role, MapRecord.slug, objects, photos)
    found = found.outerjoin(MapRecord, MapRecord.id == Mission.map_id).outerjoin(Member, member)
    rows = session.execute(found.where(Mission.id.in_(ids)).order_by(*_LAST_CHANGED_FIRST)).all()
    tracks = _tracks(session, [mission.id for mission, *_ in rows])
    return [
        Entry(mission, _role(mission, account, role), slug, tracks[mission.id], *counts)
        for mission, role, slug, *counts in rows
    ]


def _tracks(session: Session, ids: Sequence[int]) -> Mapping[int, list[Track]]:
    """Read tracks by mission id; a second query for the page could return other missions."""
    tracks = defaultdict(list)
    for begin in range(0, len(ids), _MOST_PARAMETERS):
        mine = Track.mission_id.in_(ids[begin : begin + _MOST_PARAMETERS])
        for track in session.scalars(select(Track).where(mine).order_by(Track.id)):
            tracks[track.mission_id].append(track)
    return tracks


def _role(mission: Mission, account: Account, on_map: str | None) -> str | None:
    """Return the role of an account, like `role_of`, given its role on the mission's map."""
    alone = mission.map_id is None and mission.account_id == account.id
    return "owner" if account.is_owner or alone else on_map
