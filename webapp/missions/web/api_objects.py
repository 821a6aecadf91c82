"""API of the objects of a mission."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range
from sqlalchemy.orm import Session

from webapp.core.texts import has_controls
from webapp.missions.store import missions
from webapp.missions.store import objects as mission_objects
from webapp.missions.store.missions import MOST_SIGHTINGS
from webapp.missions.store.objects import SORTS, STATES, Page, StateChange
from webapp.missions.store.schema import Mission, MissionObject, ObjectChange, ObjectSighting
from webapp.missions.web import context
from webapp.missions.web.context import mission_role, open_mission
from webapp.web.context import account, library
from webapp.web.fields import LATER, CheckedText, RecordNumber

blueprint = APIBlueprint(
    "api_mission_objects",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>/objects",
    tag="Missions",
)
blueprint.record(context.allow_any_text)

_MOST = 10_000
_MAX_NOTE = 500


class ObjectQuery(Schema):
    """Filter, order and page of the list of objects."""

    kind = String(load_default=None, validate=LATER, metadata={"description": "Only those of that class."})
    state = String(
        load_default=None, validate=OneOf(STATES), metadata={"description": "Only those in that state."}
    )
    sort = String(load_default="id", validate=OneOf(list(SORTS)))
    descending = Boolean(load_default=False)
    limit = Integer(load_default=1000, validate=Range(1, _MOST))
    offset = RecordNumber(load_default=0)


class DetectionOut(Schema):
    """Position and properties of a detection."""

    lat = Float()
    lon = Float()
    height_m = Float(allow_none=True)
    covariance = List(
        Float(),
        allow_none=True,
        metadata={"description": "Variance east, variance north, covariance of the two; square metres."},
    )
    size_m = List(Float(), allow_none=True, metadata={"description": "Length, width, height."})
    confidence = Float(allow_none=True)
    photo = String(allow_none=True, metadata={"description": "SHA-256 of a photo of the mission."})


class SightingOut(DetectionOut):
    time_s = Float()


class ObjectOut(DetectionOut):
    """An object at its latest position; an associated one at the weighted mean of its detections."""

    id = String()
    kind = String(metadata={"description": "Its class."})
    associated = Boolean(metadata={"description": "The robot sent no id: its detections were joined here."})
    first_time_s = Float()
    last_time_s = Float()
    count = Integer(metadata={"description": "How often it was seen."})
    state = String(metadata={"enum": list(STATES)})
    state_by = String(allow_none=True, metadata={"description": "Who has set it; null for visitors."})
    state_time_s = Float(allow_none=True)


class KindOut(Schema):
    """A class of objects."""

    kind = String()
    objects = Integer()


class ObjectList(Schema):
    """Objects of a mission."""

    objects = List(Nested(ObjectOut))
    total = Integer(metadata={"description": "Number of matching objects on all pages."})
    kinds = List(Nested(KindOut), metadata={"description": "Of the whole mission."})


class ChangeOut(Schema):
    """A change of the state of an object."""

    state = String(metadata={"enum": list(STATES)})
    time_s = Float()
    by = String(allow_none=True, metadata={"description": "null for visitors."})
    note = String()


class ObjectHistory(ObjectOut):
    """An object with its history, in order of arrival."""

    sightings = List(
        Nested(SightingOut), metadata={"description": f"The last {MOST_SIGHTINGS}; `count` counts all."}
    )
    changes = List(Nested(ChangeOut), metadata={"description": "Of its state, the first one first."})


class StateIn(Schema):
    """A new state of an object."""

    state = String(required=True, validate=OneOf(STATES))
    was = String(
        load_default=None,
        validate=OneOf(STATES),
        metadata={"description": "The state that the caller has seen: 409 where it is another one by now."},
    )
    note = CheckedText(
        load_default="",
        validate=Length(max=_MAX_NOTE),
        check=lambda text: not has_controls(text),
        refusal="This has control characters.",
    )


def object_json(row: MissionObject) -> dict[str, Any]:
    """Return an object as JSON; the fields of `ObjectOut`."""
    return {
        **_place_json(row),
        "id": row.object_id,
        "kind": row.kind,
        "associated": row.associated,
        "first_time_s": row.first_time_s,
        "last_time_s": row.last_time_s,
        "count": row.sightings,
        "state": row.state,
        "state_by": row.state_by,
        "state_time_s": row.state_time_s,
    }


def sighting_json(row: ObjectSighting) -> dict[str, Any]:
    """Return a sighting as JSON; the fields of `SightingOut`."""
    return {**_place_json(row), "time_s": row.time_s}


def _place_json(row: MissionObject | ObjectSighting) -> dict[str, Any]:
    return {
        "lat": row.lat,
        "lon": row.lon,
        "height_m": row.height_m,
        "covariance": row.covariance_m2,
        "size_m": row.size_m,
        "confidence": row.confidence,
        "photo": row.photo_sha,
    }


@blueprint.get("")
@blueprint.input(ObjectQuery, location="query", arg_name="query")
@blueprint.output(ObjectList)
def listed(mission_id: int, query: dict[str, Any]) -> dict[str, Any]:
    """List objects of a mission."""
    mission = open_mission(mission_id, binned=True)
    page = Page(**query)
    with library().database.read() as session:
        rows, total = mission_objects.page(session, mission.id, page)
        kinds = mission_objects.kinds(session, mission.id)
    return {
        "objects": [object_json(row) for row in rows],
        "total": total,
        "kinds": [{"kind": kind, "objects": count} for kind, count in kinds],
    }


@blueprint.get("/<text:object_id>", merge_slashes=False)
@blueprint.output(ObjectHistory)
def one(mission_id: int, object_id: str) -> dict[str, Any]:
    """Get an object with its sightings and changes of state."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        return _history(session, missions.find_object(session, mission.id, object_id))


@blueprint.patch("/<text:object_id>", merge_slashes=False)
@mission_role("editor")
@blueprint.input(StateIn, arg_name="given")
@blueprint.output(ObjectHistory)
def set_state(mission_id: int, object_id: str, *, given: dict[str, Any]) -> dict[str, Any]:
    """Set the state of an object; its history records by whom and when."""
    mission, who = open_mission(mission_id, "editor"), account()
    with library().database.write() as session:
        row = session.get_one(Mission, mission.id, with_for_update=True)
        change = StateChange(by=who.name, **given)
        found = mission_objects.change_state(session, row, object_id=object_id, change=change)
        return _history(session, found)


def _history(session: Session, row: MissionObject) -> dict[str, Any]:
    seen = missions.sightings(session, row.mission_id, row.object_id)
    changes = mission_objects.changes(session, row.mission_id, row.object_id)
    return {
        **object_json(row),
        "sightings": [sighting_json(one) for one in seen],
        "changes": [change_json(one) for one in changes],
    }


def change_json(row: ObjectChange) -> dict[str, Any]:
    """Return a change of a state as JSON; the fields of `ChangeOut`."""
    return {"state": row.state, "time_s": row.time_s, "by": row.by, "note": row.note}
