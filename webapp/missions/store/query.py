"""Queries on the rows of a mission, written as conditions (`webapp.missions.core.filters`).

Only column names from the lists here, operators of a fixed set, and bound values reach the database.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from operator import eq, ge, gt, le, lt, ne
from typing import Any, Literal, get_args

from sqlalchemy import ColumnElement, Select, and_, not_, or_, select
from sqlalchemy.orm import Session

from webapp.errors import UsageError
from webapp.missions.core.filters import (
    AllOf,
    Among,
    AnyOf,
    Between,
    Comparison,
    Condition,
    Kind,
    Like,
    Not,
    Unknown,
    parse_columns,
    parse_condition,
    parse_order,
)
from webapp.missions.store.schema import MissionObject, ObjectChange, ObjectSighting, Pose, Track
from webapp.store.database import backend_of

Table = Literal["poses", "objects", "sightings", "changes"]
TABLES: tuple[Table, ...] = get_args(Table)

MAX_ROWS = 100_000
MAX_SECONDS = 5.0
"""Time limit of a query."""

_COMPARE = {"=": eq, "!=": ne, "<": lt, "<=": le, ">": gt, ">=": ge}

_POSES: dict[str, tuple[Kind, Any]] = {
    "source": ("text", Track.source),
    "track": ("text", Track.name),
    "number": ("number", Pose.number),
    "time": ("time", Pose.time_s),
    "lat": ("number", Pose.lat),
    "lon": ("number", Pose.lon),
    "height_m": ("number", Pose.height_m),
    "heading_deg": ("number", Pose.heading_deg),
    "var_e": ("number", Pose.var_e),
    "var_n": ("number", Pose.var_n),
    "cov_en": ("number", Pose.cov_en),
    "travelled_m": ("number", Pose.travelled_m),
}
_MEASURED = (
    "lat", "lon", "height_m", "confidence", "var_e", "var_n", "cov_en", "size_x_m", "size_y_m", "size_z_m",
)  # fmt: skip


def _measured(table: type[MissionObject | ObjectSighting]) -> dict[str, tuple[Kind, Any]]:
    return {name: ("number", getattr(table, name)) for name in _MEASURED}


_OBJECTS: dict[str, tuple[Kind, Any]] = {
    "id": ("text", MissionObject.object_id),
    "class": ("text", MissionObject.kind),
    **_measured(MissionObject),
    "sightings": ("number", MissionObject.sightings),
    "first_time": ("time", MissionObject.first_time_s),
    "last_time": ("time", MissionObject.last_time_s),
    "state": ("text", MissionObject.state),
    "state_time": ("time", MissionObject.state_time_s),
    "state_by": ("text", MissionObject.state_by),
    "photo": ("text", MissionObject.photo_sha),
}
_SIGHTINGS: dict[str, tuple[Kind, Any]] = {
    "id": ("text", ObjectSighting.object_id),
    "class": ("text", MissionObject.kind),
    "number": ("number", ObjectSighting.number),
    "time": ("time", ObjectSighting.time_s),
    **_measured(ObjectSighting),
    "photo": ("text", ObjectSighting.photo_sha),
}
_CHANGES: dict[str, tuple[Kind, Any]] = {
    "id": ("text", ObjectChange.object_id),
    "class": ("text", MissionObject.kind),
    "number": ("number", ObjectChange.number),
    "state": ("text", ObjectChange.state),
    "time": ("time", ObjectChange.time_s),
    "by": ("text", ObjectChange.by),
    "note": ("text", ObjectChange.note),
}
_TABLES = {"poses": _POSES, "objects": _OBJECTS, "sightings": _SIGHTINGS, "changes": _CHANGES}


@dataclass(frozen=True, slots=True)
class Question:
    table: str  # One of `TABLES`
    # `select`, `where`, `order`: Columns, condition, sort order; empty for all columns, all rows, no order.
    select: str = ""
    where: str = ""
    order: str = ""
    limit: int = 1000  # Maximum number of rows, up to `MAX_ROWS`


@dataclass(frozen=True, slots=True)
class ParsedQuery:
    columns: tuple[str, ...]
    rows: Select[Any]  # Selects one row more than the limit, to detect whether there are more


def parse_question(mission_id: int, question: Question) -> ParsedQuery:
    """Parse a query on a mission.

    Raises:
        UsageError: Invalid syntax; `where` gives the field and the character.
    """
    if question.table not in _TABLES:
        raise UsageError(
            f"there is no table {question.table!r}", where="from", hint=f"use {', '.join(TABLES)}"
        )
    if not 0 <= question.limit <= MAX_ROWS:
        raise UsageError(f"{question.limit} rows are too many", where="limit", hint=f"at most {MAX_ROWS}")
    table = _TABLES[question.table]
    kinds: Mapping[str, Kind] = {name: kind for name, (kind, _) in table.items()}
    chosen = parse_columns(question.select, kinds)
    condition = parse_condition(question.where, kinds)
    order = parse_order(question.order, kinds)
    rows = _rows(question.table, mission_id, [table[name][1] for name in chosen])
    if condition is not None:
        rows = rows.where(_expression(condition, table))
    if order:
        by = (table[one.column][1] for one in order)
        rows = rows.order_by(
            *(
                column.desc().nulls_last() if one.descending else column.asc().nulls_first()
                for one, column in zip(order, by, strict=True)
            )
        )
    return ParsedQuery(tuple(chosen), rows.limit(question.limit + 1))


def answer(session: Session, asked: ParsedQuery) -> Generator[tuple[Any, ...], None, None]:
    """Run a query; yield its rows.

    Raises:
        UsageError: The query exceeds the time limit.
    """
    until = time.monotonic() + MAX_SECONDS
    try:
        with (
            backend_of(session).time_limit(session, MAX_SECONDS),
            session.execute(asked.rows, execution_options={"yield_per": 500}) as rows,
        ):
            for row in rows:
                yield tuple(row)
                if time.monotonic() > until:
                    raise TimeoutError
    except TimeoutError as error:
        raise UsageError(
            f"the query takes more than {MAX_SECONDS:g} seconds",
            where="where",
            hint="select fewer rows: numbers or times between two values, and no order",
        ) from error


def _rows(table: str, mission_id: int, columns: Sequence[Any]) -> Select[Any]:
    if table == "poses":
        stored = and_(Pose.track_id == Track.id, Pose.number < Track.poses)  # later ones are deleted
        joined = select(*columns).select_from(Track).join(Pose, stored)
        return joined.where(Track.mission_id == mission_id)
    if table == "objects":
        return select(*columns).where(MissionObject.mission_id == mission_id)
    listed = ObjectSighting if table == "sightings" else ObjectChange
    same = and_(listed.mission_id == MissionObject.mission_id, listed.object_id == MissionObject.object_id)
    joined = select(*columns).select_from(MissionObject).join(listed, same)
    return joined.where(MissionObject.mission_id == mission_id)


def _expression(condition: Condition, table: Mapping[str, tuple[Kind, Any]]) -> ColumnElement[bool]:
    """Convert a condition to an expression whose values are bound parameters."""
    made: Any
    match condition:
        case AllOf(parts):
            made = and_(*(_expression(part, table) for part in parts))
        case AnyOf(parts):
            made = or_(*(_expression(part, table) for part in parts))
        case Not(part):
            made = not_(_expression(part, table))
        case Comparison(column, operator, value):
            made = _COMPARE[operator](table[column][1], value)
        case Between(column, low, high):
            made = table[column][1].between(low, high)
        case Among(column, values):
            made = table[column][1].in_(values)
        case Like(column, pattern):
            made = table[column][1].ilike(pattern.replace("\\", "\\\\"), escape="\\")
        case Unknown(column):
            made = table[column][1].is_(None)
    expression: ColumnElement[bool] = made
    return expression
