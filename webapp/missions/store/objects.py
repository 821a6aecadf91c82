"""Lists of the objects of a mission: paged, sorted, filtered, and counted by class."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from webapp.missions.store.schema import MissionObject

SORTS: dict[str, InstrumentedAttribute[str] | InstrumentedAttribute[float] | InstrumentedAttribute[int]] = {
    "id": MissionObject.object_id,
    "kind": MissionObject.kind,
    "first_time_s": MissionObject.first_time_s,
    "last_time_s": MissionObject.last_time_s,
    "count": MissionObject.sightings,
}
"""Sort keys of objects."""


@dataclass(frozen=True, slots=True)
class Page:
    """A page of a list."""

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
