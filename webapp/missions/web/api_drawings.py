"""API of what people draw on a mission: search areas with their coverage, lines and markers."""

from __future__ import annotations

from functools import cache
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range

from webapp.missions.core import drawings as shapes
from webapp.missions.core.drawings import (
    KINDS,
    LEAST_RADIUS_M,
    MAX_NOTE,
    MOST_POINTS,
    MOST_RADIUS_M,
    RADIUS_M,
)
from webapp.missions.store import batches, drawings
from webapp.missions.store.schema import MissionDrawing
from webapp.missions.tasks.coverage import AreaCoverage, CoverageCache
from webapp.missions.web.context import mission_role, open_mission
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library
from webapp.web.fields import LATER, Boolean, BoundedList, RecordNumber

blueprint = APIBlueprint(
    "api_mission_drawings", __name__, url_prefix="/api/v1/missions/<id:mission_id>", tag="Missions"
)

_limit = ConcurrencyLimit("coverage", share=0.25)
"""A new area is compared with all poses: other requests keep most of the threads."""
blueprint.record(_limit.set_up)

_ID = "/drawings/<id:drawing_id>"
_WHO = "null or empty for visitors."


class DrawingFields(Schema):
    """What people set of a drawing."""

    name = String(validate=LATER, metadata={"example": "Slope north of the river"})
    note = String(validate=Length(max=MAX_NOTE))
    points = BoundedList(
        BoundedList(Float(allow_nan=False), least=2, most=2),
        least=1,
        most=MOST_POINTS + 1,
        metadata={"description": "Degrees north, degrees east; the outline of an area may not cross itself."},
    )
    assigned = String(validate=LATER, metadata={"description": "Assignee of the area; may be empty."})
    radius_m = Float(
        allow_nan=False,
        validate=Range(LEAST_RADIUS_M, MOST_RADIUS_M),
        metadata={"description": f"What a track passes within counts as covered; {RADIUS_M:g} by default."},
    )
    searched = Boolean(metadata={"description": "Whether the area has been searched, as somebody says."})


class NewDrawing(DrawingFields):
    """A drawing to be added."""

    kind = String(required=True, validate=OneOf(KINDS))
    name = String(required=True, validate=LATER)
    points = BoundedList(
        BoundedList(Float(allow_nan=False), least=2, most=2), least=1, most=MOST_POINTS + 1, required=True
    )


class DrawingChange(DrawingFields):
    """Changes of a drawing; fields that are not sent stay."""

    revision = RecordNumber(
        load_default=None,
        metadata={"description": "That the caller has seen: 409 where it is another one by now."},
    )


class DrawingDeleteQuery(Schema):
    """What the caller has seen of the drawing."""

    revision = RecordNumber(
        load_default=None, metadata={"description": "409 where it is another one by now."}
    )


class DrawingOut(Schema):
    """A search area, a line or a marker."""

    id = Integer()
    kind = String(metadata={"enum": list(KINDS)})
    name = String()
    note = String(metadata={"description": _WHO})
    points = List(List(Float()), metadata={"description": "Degrees north, degrees east."})
    area_m2 = Float(allow_none=True, metadata={"description": "Of an area."})
    length_m = Float(allow_none=True, metadata={"description": "Of a line, or around an area."})
    assigned = String(metadata={"description": _WHO})
    radius_m = Float(allow_none=True, metadata={"description": "Of an area."})
    searched = Boolean()
    searched_by = String(allow_none=True, metadata={"description": _WHO})
    searched_time_s = Float(allow_none=True)
    created_by = String(allow_none=True, metadata={"description": _WHO})
    created_time_s = Float()
    changed_by = String(allow_none=True, metadata={"description": _WHO})
    changed_time_s = Float()
    revision = Integer(metadata={"description": "Counts the changes of this drawing."})


class DrawingList(Schema):
    """The drawings of a mission, in order of creation."""

    drawings = List(Nested(DrawingOut))


class AreaCoverageOut(Schema):
    """How much of a search area was covered."""

    id = Integer(metadata={"description": "Of the drawing."})
    share = Float(
        allow_none=True, metadata={"description": "0 to 1; null: the area is too narrow to be measured."}
    )
    tracks = List(Integer(), metadata={"description": "Ids of the tracks that count."})
    exact = Boolean(metadata={"description": "false: thinning has removed poses of these tracks."})


class CoverageOut(Schema):
    """The coverage of all search areas."""

    areas = List(Nested(AreaCoverageOut))


def drawing_json(row: MissionDrawing, *, visitor: bool = False) -> dict[str, Any]:
    """Return a drawing as JSON; visitors get neither names of people nor notes."""
    points = drawings.points_of(row)
    metres = shapes.to_metres(points)
    around = shapes.length_m(metres) if row.kind != "marker" else None
    if around is not None and row.kind == "area":
        around += shapes.length_m(metres[[-1, 0]])
    return {
        "id": row.id,
        "kind": row.kind,
        "name": row.name,
        "note": "" if visitor else row.note,
        "points": points,
        "area_m2": shapes.area_m2(metres) if row.kind == "area" else None,
        "length_m": around,
        "assigned": "" if visitor else row.assigned,
        "radius_m": row.radius_m,
        "searched": row.searched_time_s is not None,
        "searched_by": None if visitor else row.searched_by,
        "searched_time_s": row.searched_time_s,
        "created_by": None if visitor else row.created_by,
        "created_time_s": row.created_time_s,
        "changed_by": None if visitor else row.changed_by,
        "changed_time_s": row.changed_time_s,
        "revision": row.revision,
    }


def coverage_json(mission_id: int) -> dict[str, Any]:
    """Return the coverage of the areas of a mission; the fields of `CoverageOut`. Raises Busy."""
    with _limit.slot():
        return {"areas": [_coverage(one) for one in _covered().of_mission(library(), mission_id)]}


@cache
def _covered() -> CoverageCache:
    return CoverageCache()


def _coverage(found: AreaCoverage) -> dict[str, Any]:
    return {"id": found.id, "share": found.share, "tracks": found.tracks, "exact": found.exact}


@blueprint.get("/drawings")
@blueprint.output(DrawingList)
def list_drawings(mission_id: int) -> dict[str, Any]:
    """List the search areas, lines and markers of a mission."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        found = drawings.list_drawings(session, mission.id)
    return {"drawings": [drawing_json(row) for row in found]}


@blueprint.post("/drawings")
@mission_role("editor")
@blueprint.input(NewDrawing, arg_name="given")
@blueprint.output(DrawingOut, status_code=201)
def add(mission_id: int, given: dict[str, Any]) -> dict[str, Any]:
    """Draw a search area, a line or a marker."""
    mission, who = open_mission(mission_id, "editor"), account()
    with library().database.write(locks_rows=True) as session:
        row = batches.locked(session, mission.id)
        kind = given.pop("kind")
        return drawing_json(drawings.add(session, row, kind=kind, by=who.name, fields=given))


@blueprint.patch(_ID)
@mission_role("editor")
@blueprint.input(DrawingChange, arg_name="given")
@blueprint.output(DrawingOut)
def change(mission_id: int, drawing_id: int, *, given: dict[str, Any]) -> dict[str, Any]:
    """Change a drawing: its name, shape, assignee, or that it was searched."""
    mission, who = open_mission(mission_id, "editor"), account()
    seen = given.pop("revision")
    with library().database.write(locks_rows=True) as session:
        row = batches.locked(session, mission.id)
        found = drawings.change(session, row, id=drawing_id, by=who.name, fields=given, seen=seen)
        return drawing_json(found)


@blueprint.delete(_ID)
@mission_role("editor")
@blueprint.input(DrawingDeleteQuery, location="query", arg_name="query")
@blueprint.output({}, status_code=204)
def remove(mission_id: int, drawing_id: int, *, query: dict[str, Any]) -> tuple[str, int]:
    """Delete a drawing."""
    mission = open_mission(mission_id, "editor")
    with library().database.write(locks_rows=True) as session:
        row = batches.locked(session, mission.id)
        drawings.remove(session, row, id=drawing_id, seen=query["revision"])
    return "", 204


@blueprint.get("/coverage")
@mission_role("viewer")
@blueprint.output(CoverageOut)
def coverage(mission_id: int) -> dict[str, Any]:
    """Get how much of each search area the tracks have covered."""
    return coverage_json(open_mission(mission_id).id)
