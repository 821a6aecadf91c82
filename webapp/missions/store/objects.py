"""Objects of a mission: lists of them, paged, filtered and counted; and their states, set by people."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal, get_args

from sqlalchemy import func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from webapp.errors import Conflict
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionObject, ObjectChange

SORTS: dict[str, InstrumentedAttribute[str] | InstrumentedAttribute[float] | InstrumentedAttribute[int]] = {
    "id": MissionObject.object_id,
    "kind": MissionObject.kind,
    "first_time_s": MissionObject.first_time_s,
    "last_time_s": MissionObject.last_time_s,
    "count": MissionObject.sightings,
}
"""Sort keys of objects."""

_State = Literal["found", "confirmed", "cleared", "dismissed"]
"""Found by a robot; confirmed by a person; done; a false detection."""

STATES: tuple[_State, ...] = get_args(_State)


@dataclass(frozen=True, slots=True)
class Page:
    kind: str | None = None  # Only objects of that class
    state: str | None = None  # Only objects in that state
    sort: str = "id"  # One of `SORTS`
    descending: bool = False
    limit: int = 1000
    offset: int = 0


def page(session: Session, mission_id: int, wanted: Page) -> tuple[list[MissionObject], int]:
    """Read a page of the objects of a mission; return it with the total number that match."""
    fitting = [MissionObject.mission_id == mission_id]
    if wanted.kind is not None:
        fitting.append(MissionObject.kind == wanted.kind)
    if wanted.state is not None:
        fitting.append(MissionObject.state == wanted.state)
    by = SORTS[wanted.sort]
    order = by.desc() if wanted.descending else by
    found = select(MissionObject).where(*fitting).order_by(order, MissionObject.object_id)
    rows = session.scalars(found.limit(wanted.limit).offset(wanted.offset))
    return list(rows), session.scalar(select(func.count()).where(*fitting)) or 0


def changed_since(
    session: Session, mission_id: int, *, since: int, most: int
) -> tuple[list[MissionObject], int | None]:
    """List objects that changed after a revision of the mission, the least recently changed first.

    Args:
        most: Maximum number; only complete revisions are returned, and exceed it if the first one does.

    Returns:
        The revision up to which the list is complete; None for the latest one.
    """
    mine = select(MissionObject).where(MissionObject.mission_id == mission_id)
    later = mine.where(MissionObject.revision > since).order_by(
        MissionObject.revision, MissionObject.object_id
    )
    rows = list(session.scalars(later.limit(most + 1)))
    if len(rows) <= most:
        return rows, None
    until = rows[-1].revision
    if rows[0].revision == until:
        return list(session.scalars(mine.where(MissionObject.revision == until))), until
    return [row for row in rows if row.revision < until], until - 1


def kinds(session: Session, mission_id: int) -> list[tuple[str, int]]:
    """Count the objects of a mission by class."""
    of_mission = select(MissionObject.kind, func.count()).where(MissionObject.mission_id == mission_id)
    found = session.execute(of_mission.group_by(MissionObject.kind).order_by(MissionObject.kind))
    return [(kind, count) for kind, count in found]


@dataclass(frozen=True, slots=True)
class StateChange:
    """A new state of an object."""

    state: _State
    by: str  # Name of the account
    was: _State | None = None  # The previous state that they expect; None for any
    note: str = ""


def change_state(session: Session, mission: Mission, *, object_id: str, change: StateChange) -> MissionObject:
    """Set the state of an object; a repeated state without a note has no effect.

    Raises:
        NotFound: The mission has no object of this id.
        Conflict: The state of the object is not the one that the caller expects.
    """
    row = missions.find_object(session, mission.id, object_id)
    if change.state == row.state and not change.note:
        return row
    if change.was not in (None, row.state):
        if row.state_by is None:
            text = f"the object is {row.state}: nobody has set another state"
        else:
            text = f"{row.state_by} has set the object to {row.state} meanwhile"
        raise Conflict(text, where="was", hint="look at it again, and set the state again")
    missions.count_change(mission)
    row.state, row.state_by, row.state_time_s = change.state, change.by, time.time()
    row.revision = mission.revision
    of_object = (ObjectChange.mission_id == mission.id, ObjectChange.object_id == object_id)
    session.add(
        ObjectChange(
            mission_id=mission.id,
            object_id=object_id,
            number=session.scalar(select(func.count()).where(*of_object)) or 0,
            state=change.state,
            time_s=row.state_time_s,
            by=change.by,
            note=change.note,
        )
    )
    session.flush()
    return row


def changes(session: Session, mission_id: int, object_id: str) -> list[ObjectChange]:
    """List the changes of an object's state, oldest first."""
    mine = (ObjectChange.mission_id == mission_id, ObjectChange.object_id == object_id)
    return list(session.scalars(select(ObjectChange).where(*mine).order_by(ObjectChange.number)))
