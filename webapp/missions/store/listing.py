"""The list of missions with what it shows of each, in as many statements for a thousand as for one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.orm import Session

from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionObject, MissionPhoto, Track
from webapp.store.schema import Account, MapRecord, Member

_LAST_CHANGED_FIRST = (Mission.changed_at.desc(), Mission.id.desc())
_MOST_PARAMETERS = 10_000


class ListCursor(NamedTuple):
    """A place in the list: just after a mission as it was then, wherever that mission is now."""

    changed_at: datetime
    id: int


@dataclass(frozen=True, slots=True)
class Entry:
    """A mission in a list.

    Attributes
    ----------
    role : str or None
        Of who asks.
    slug : str or None
        Of its map.
    tracks : list of Track
        The first made first.
    """

    mission: Mission
    role: str | None
    slug: str | None
    tracks: list[Track]
    objects: int
    photos: int

    @property
    def poses(self) -> int:
        """Of all tracks."""
        return sum(track.poses for track in self.tracks)

    @property
    def spot(self) -> ListCursor:
        """Where the list goes on after it."""
        return ListCursor(self.mission.changed_at, self.mission.id)


def listed(
    session: Session,
    account: Account,
    *,
    map_id: int | None = None,
    binned: bool = False,
    after: ListCursor | None = None,
    limit: int | None = None,
) -> list[Entry]:
    """List the missions that an account may see, the last changed first.

    Parameters
    ----------
    map_id : int or None
        Only those on that map.
    binned : bool
        Those in the bin instead.
    after : ListCursor or None
        Only those after it.
    limit : int or None
        At most so many; None for all.
    """
    ids = missions.visible(session, account, binned=binned)
    if map_id is not None:
        ids = ids.where(Mission.map_id == map_id)
    if after is not None:
        same = and_(Mission.changed_at == after.changed_at, Mission.id < after.id)
        ids = ids.where(or_(Mission.changed_at < after.changed_at, same))
    return _entries(session, account, ids.order_by(*_LAST_CHANGED_FIRST).limit(limit))


def one(session: Session, mission: Mission, *, account: Account) -> Entry:
    """Return the list entry of a mission."""
    (entry,) = _entries(session, account, select(Mission.id).where(Mission.id == mission.id))
    return entry


def _entries(session: Session, account: Account, ids: Select[Any]) -> list[Entry]:
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
    """Read tracks by the ids of their missions: the page may begin elsewhere when it is asked for again."""
    tracks = defaultdict(list)
    for begin in range(0, len(ids), _MOST_PARAMETERS):
        mine = Track.mission_id.in_(ids[begin : begin + _MOST_PARAMETERS])
        for track in session.scalars(select(Track).where(mine).order_by(Track.id)):
            tracks[track.mission_id].append(track)
    return tracks


def _role(mission: Mission, account: Account, on_map: str | None) -> str | None:
    """Return the role of an account, as `missions.role_of` does, by that on the mission's map."""
    alone = mission.map_id is None and mission.account_id == account.id
    return "owner" if account.is_owner or alone else on_map
