"""What was seen on a mission."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Float, Integer, List, Nested, String
from apiflask.validators import OneOf, Range

from webapp.missions.store import missions
from webapp.missions.store import objects as mission_objects
from webapp.missions.store.missions import MOST_SIGHTINGS
from webapp.missions.store.objects import SORTS, Page
from webapp.missions.store.schema import MissionObject, ObjectSighting
from webapp.missions.web import context
from webapp.missions.web.context import open_mission
from webapp.web.context import library

blueprint = APIBlueprint(
    "api_mission_objects",
    __name__,
    url_prefix="/api/v1/missions/<int(max=2147483647):mission_id>/objects",
    tag="Missions",
)
blueprint.record(context.allow_any_text)

_MOST = 10_000


class ObjectQuery(Schema):
    """Which objects, in which order."""

    kind = String(load_default=None, metadata={"description": "Only those of that class."})
    sort = String(load_default="id", validate=OneOf(list(SORTS)))
    descending = Boolean(load_default=False)
    limit = Integer(load_default=1000, validate=Range(1, _MOST))
    offset = Integer(load_default=0, validate=Range(0, 2**53))


class SightingOut(Schema):
    """One time that an object was seen."""

    time_s = Float()
    lat = Float()
    lon = Float()
    height_m = Float(allow_none=True)
    confidence = Float(allow_none=True)
    photo = String(allow_none=True, metadata={"description": "SHA-256 of a photo of the mission."})


class ObjectOut(Schema):
    """An object, where it was seen at the latest time."""

    id = String()
    kind = String(metadata={"description": "Its class."})
    lat = Float()
    lon = Float()
    height_m = Float(allow_none=True)
    confidence = Float(allow_none=True)
    first_time_s = Float()
    last_time_s = Float()
    photo = String(allow_none=True, metadata={"description": "SHA-256 of a photo of the mission."})
    count = Integer(metadata={"description": "How often it was seen."})


class KindOut(Schema):
    """A class of objects."""

    kind = String()
    objects = Integer()


class ObjectList(Schema):
    """Objects of a mission."""

    objects = List(Nested(ObjectOut))
    total = Integer(metadata={"description": "All that fit, on other pages too."})
    kinds = List(Nested(KindOut), metadata={"description": "Of the whole mission."})


class ObjectHistory(ObjectOut):
    """An object with its history, in the order in which it came."""

    sightings = List(
        Nested(SightingOut), metadata={"description": f"The last {MOST_SIGHTINGS}; `count` counts all."}
    )


def object_json(row: MissionObject) -> dict[str, Any]:
    """Return an object as JSON; the fields of `ObjectOut`."""
    return {
        "id": row.object_id,
        "kind": row.kind,
        "lat": row.lat,
        "lon": row.lon,
        "height_m": row.height_m,
        "confidence": row.confidence,
        "first_time_s": row.first_time_s,
        "last_time_s": row.last_time_s,
        "photo": row.photo_sha,
        "count": row.sightings,
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
    """Get an object, with its sightings."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        row = missions.find_object(session, mission.id, object_id)
        seen = missions.sightings(session, mission.id, object_id)
    return {**object_json(row), "sightings": [_sighting(one) for one in seen]}


def _sighting(row: ObjectSighting) -> dict[str, Any]:
    return {
        "time_s": row.time_s,
        "lat": row.lat,
        "lon": row.lon,
        "height_m": row.height_m,
        "confidence": row.confidence,
        "photo": row.photo_sha,
    }
