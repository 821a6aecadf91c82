"""The task list: the state that people have set for each object, by whom and when."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal, get_args

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.errors import Conflict
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionObject, ObjectChange

State = Literal["found", "confirmed", "cleared", "dismissed"]
"""Found by a robot; confirmed by a person; done; a false detection."""

STATES: tuple[State, ...] = get_args(State)


@dataclass(frozen=True, slots=True)
class StateChange:
    """A new state of an object."""

    state: State
    by: str  # Name of the account
    was: State | None = None  # The previous state that they expect; None for any
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
