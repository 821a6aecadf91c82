"""Search areas, lines and markers that people draw on a mission."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.core import texts
from webapp.errors import Conflict, NotFound, UsageError
from webapp.missions.core import drawings as shapes
from webapp.missions.core.drawings import MAX_NAME, MAX_NOTE, RADIUS_M, Kind
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionDrawing

MOST = 500
"""Maximum number of drawings of a mission."""

_FLOAT64 = np.dtype("<f8")
_ONLY_AREAS = ("assigned", "radius_m", "searched")


def points_of(row: MissionDrawing) -> list[tuple[float, float]]:
    """Return the points of a drawing: degrees north, degrees east."""
    return [(lat, lon) for lat, lon in np.frombuffer(row.points, _FLOAT64).reshape(-1, 2).tolist()]


def list_drawings(session: Session, mission_id: int) -> list[MissionDrawing]:
    """List the drawings of a mission in order of creation."""
    return list(
        session.scalars(
            select(MissionDrawing).where(MissionDrawing.mission_id == mission_id).order_by(MissionDrawing.id)
        )
    )


def find(session: Session, mission_id: int, id: int) -> MissionDrawing:
    """Find a drawing of a mission. Raises NotFound."""
    row = session.get(MissionDrawing, id)
    if row is None or row.mission_id != mission_id:
        raise NotFound(
            "drawing not found in the mission", where=f"drawing {id}", hint="somebody may have deleted it"
        )
    return row


def add(
    session: Session, mission: Mission, *, kind: Kind, by: str, fields: Mapping[str, Any]
) -> MissionDrawing:
    """Add a drawing.

    Args:
        by: Name of the account.
        fields: `name`, `points`, and perhaps `note`; of an area also `assigned`, `radius_m` and `searched`.

    Raises:
        UsageError: A field is invalid, or the mission has too many drawings.
    """
    count = session.scalar(select(func.count()).where(MissionDrawing.mission_id == mission.id)) or 0
    if count >= MOST:
        raise UsageError(f"a mission has at most {MOST} drawings", hint="delete some, or begin a new mission")
    at = time.time()
    row = MissionDrawing(
        mission_id=mission.id, kind=kind, created_by=by, created_time_s=at, note="", assigned=""
    )
    row.radius_m = RADIUS_M if kind == "area" else None
    _set(row, fields, by=by, at=at)
    row.changed_by, row.changed_time_s = by, at
    session.add(row)
    _count(mission)
    session.flush()
    return row


def change(
    session: Session, mission: Mission, *, id: int, by: str, fields: Mapping[str, Any], seen: int | None
) -> MissionDrawing:
    """Change some fields of a drawing, as for `add`; without a difference nothing happens.

    Args:
        seen: The revision of the drawing that the caller has seen; None for any.

    Raises:
        NotFound, UsageError
        Conflict: Somebody else has changed it in the meantime.
    """
    row = find(session, mission.id, id)
    _check_seen(row, seen)
    before = _values(row)
    _set(row, fields, by=by, at=time.time())
    if _values(row) != before:
        row.changed_by, row.changed_time_s = by, time.time()
        row.revision += 1
        _count(mission)
        session.flush()
    return row


def remove(session: Session, mission: Mission, *, id: int, seen: int | None) -> None:
    """Delete a drawing; `seen` and errors are those of `change`."""
    row = find(session, mission.id, id)
    _check_seen(row, seen)
    session.delete(row)
    _count(mission)
    session.flush()


def has_same(session: Session, mission_id: int, *, kind: Kind, name: str, points: Sequence[Any]) -> bool:
    """Return whether a mission has a drawing of this name and shape."""
    same = (
        MissionDrawing.kind == kind,
        MissionDrawing.name == name,
        MissionDrawing.points == _packed(points),
    )
    return (
        session.scalar(
            select(MissionDrawing.id).where(MissionDrawing.mission_id == mission_id, *same).limit(1)
        )
        is not None
    )


def _check_seen(row: MissionDrawing, seen: int | None) -> None:
    if seen is not None and seen != row.revision:
        raise Conflict(
            f"{row.changed_by} has changed {row.name!r} meanwhile",
            where="revision",
            hint="look at it again, and repeat the change",
        )


def _count(mission: Mission) -> None:
    missions.count_change(mission)
    mission.drawings_revision = mission.revision


def _set(row: MissionDrawing, fields: Mapping[str, Any], *, by: str, at: float) -> None:
    if row.kind != "area" and any(fields.get(name) for name in _ONLY_AREAS):
        raise UsageError(f"only areas have {', '.join(_ONLY_AREAS)}", where="kind")
    if "name" in fields:
        row.name = _name(fields["name"])
    if "note" in fields:
        row.note = _note(fields["note"])
    if "assigned" in fields:
        row.assigned = _name(fields["assigned"], where="assigned") if fields["assigned"].strip() else ""
    if "points" in fields:
        row.points = _packed(shapes.checked_points(row.kind, fields["points"]))  # type: ignore[arg-type]
    if fields.get("radius_m") is not None:
        row.radius_m = _radius(fields["radius_m"])
    searched = fields.get("searched")
    if searched is True and row.searched_time_s is None:
        row.searched_by, row.searched_time_s = by, at
    elif searched is False:
        row.searched_by = row.searched_time_s = None


def _values(row: MissionDrawing) -> tuple[Any, ...]:
    return (row.name, row.note, row.assigned, row.points, row.radius_m, row.searched_by, row.searched_time_s)


def _name(text: str, *, where: str = "name") -> str:
    tidy = texts.tidy_name(text, most=MAX_NAME)
    if tidy is None:
        hint = f"give 1 to {MAX_NAME} printable characters"
        raise UsageError("this is not a valid name", where=where, hint=hint)
    return tidy


def _note(text: str) -> str:
    if len(text) > MAX_NOTE or texts.has_controls(text, besides="\n\r\t"):
        hint = f"give at most {MAX_NOTE} printable characters"
        raise UsageError("this is not a valid note", where="note", hint=hint)
    return text


def _radius(value: float) -> float:
    if not shapes.LEAST_RADIUS_M <= value <= shapes.MOST_RADIUS_M:  # NaN neither
        hint = f"give {shapes.LEAST_RADIUS_M:g} to {shapes.MOST_RADIUS_M:g} metres"
        raise UsageError("this is not a valid radius", where="radius_m", hint=hint)
    return value


def _packed(points: Sequence[tuple[float, float]]) -> bytes:
    return np.asarray(points, dtype=_FLOAT64).tobytes()
