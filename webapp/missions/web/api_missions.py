"""API of missions: schemas, list, state, and changes of name, map, start, note and mark."""

from __future__ import annotations

from typing import Any

import numpy as np
from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import Length, Range

from webapp.missions.core.looks import WIDTH_PX
from webapp.missions.core.trajectory.records import SOURCES
from webapp.missions.store import missions, shares
from webapp.missions.store.robots import LEAST_SILENT_S, MOST_SILENT_S
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import delete
from webapp.missions.tasks.preview import MissionPreview, preview_missions
from webapp.missions.web import state
from webapp.missions.web.context import mission_role, open_mission
from webapp.store.maps import maps
from webapp.store.maps.maps import ROLES
from webapp.store.schema import MapRecord
from webapp.web.context import account, library, open_map
from webapp.web.fields import LATER, Boolean, ListPartQuery, split, wanted_part
from webapp.web.maps.schemas import SatelliteOut
from webapp.web.openapi import json_answer

blueprint = APIBlueprint("api_missions", __name__, url_prefix="/api/v1/missions", tag="Missions")
_FINE = 500
"""In previews up to this size, coordinates are not rounded to whole numbers."""

_ID = "<id:mission_id>"


class StartOut(Schema):
    """Origin of the robot's frame, and heading of its x axis."""

    lat = Float()
    lon = Float()
    heading_deg = Float(metadata={"description": "Clockwise from north."})


class LastOut(Schema):
    """The last pose of a track."""

    time_s = Float()
    lat = Float()
    lon = Float()
    heading_deg = Float(allow_none=True)
    covariance_m2 = List(
        Float(),
        allow_none=True,
        metadata={"description": "Variance east, variance north, covariance of the two; null: unknown."},
    )


class ClosingOut(Schema):
    """Loop closure error: the distance between the start and the end of a track that returns."""

    gap_m = Float()
    share = Float(metadata={"description": "Of the distance travelled."})


class TrackLookOut(Schema):
    """How a track looks, as far as people have set it."""

    title = String(metadata={"description": "Empty: it is called by its source and name."})
    colour = String(allow_none=True, metadata={"description": "`#rrggbb`; null: that of its source."})
    width_px = Float(allow_none=True, metadata={"description": f"null: {WIDTH_PX:g}."})
    hidden = Boolean(metadata={"description": "Pages show it only once it is ticked."})


class TrackOut(Schema):
    """A track."""

    id = Integer()
    source = String(metadata={"enum": list(SOURCES)})
    name = String(metadata={"description": "Given by its sender; distinguishes tracks of one source."})
    look = Nested(TrackLookOut)
    poses = Integer()
    skipped = Integer(metadata={"description": "Poses that the sender left out."})
    removed = Integer(metadata={"description": "Poses that thinning removed."})
    thinned_m = Float(
        allow_none=True,
        metadata={"description": "Largest error of thinning, metres; null: none, or only the ends are left."},
    )
    distance_m = Float()
    duration_s = Float()
    timed = Boolean(
        metadata={
            "description": "false: its source has no times. Those of its poses keep their order and "
            "mean nothing; duration and speeds are not known."
        }
    )
    first_time_s = Float(allow_none=True)
    last_time_s = Float(allow_none=True)
    bounds = List(Float(), allow_none=True, metadata={"description": "South, west, north, east."})
    last = Nested(LastOut, allow_none=True)
    closing = Nested(ClosingOut, allow_none=True, metadata={"description": "null: it does not come back."})


class MissionSummary(Schema):
    """A mission in a list."""

    id = Integer()
    name = String()
    url = String(metadata={"description": "Of its page."})
    map = String(allow_none=True, metadata={"description": "Slug of its map."})
    role = String(metadata={"enum": list(ROLES), "description": "Of the caller."})
    can_edit = Boolean()
    binned = Boolean()
    keep = Boolean(metadata={"description": "Its tracks are never thinned."})
    revision = Integer(metadata={"description": "Counts the changes."})
    created_at = String()
    changed_at = String()
    ended_at = String(allow_none=True)
    poses = Integer()
    distance_m = Float(metadata={"description": "Of all tracks from the source that knows it best."})
    duration_s = Float()
    first_time_s = Float(allow_none=True, metadata={"description": "Of its poses; null: they have no times."})
    last_time_s = Float(allow_none=True)
    objects = Integer()
    photos = Integer()


class MissionPreviewOut(Schema):
    """Preview of a mission for SVG, in its own units."""

    image = String(allow_none=True, metadata={"description": "Of the map, to be laid below it."})
    width = Float()
    height = Float()
    line = String(metadata={"description": "Path of the best track."})
    dots = String(metadata={"description": "Path with a point for each object."})


class MissionEntry(MissionSummary):
    """A mission of the list."""

    preview = Nested(
        MissionPreviewOut,
        allow_none=True,
        metadata={"description": "null: it has no positions, or `previews` was not sent."},
    )


class MissionList(Schema):
    """Missions, the most recently changed first."""

    missions = List(Nested(MissionEntry))
    next = String(allow_none=True, metadata={"description": "`after` for those that follow; null: none do."})


class MissionSatelliteOut(SatelliteOut):
    """The image of the mission's map."""

    georeference = Dict(allow_none=True, metadata={"description": "As in the state of the map."})


class MissionState(MissionSummary):
    """A mission without its poses, objects and photos."""

    note = String()
    start = Nested(StartOut, allow_none=True)
    drawings_revision = Integer(metadata={"description": "Another number means that drawings changed."})
    tracks = List(Nested(TrackOut))
    satellite = Nested(MissionSatelliteOut, allow_none=True)
    cursor = String(metadata={"description": "For the events: the state of the mission that is known."})


class MissionListQuery(ListPartQuery):
    """Filter of the list of missions."""

    map = String(load_default=None, validate=LATER, metadata={"description": "Slug: only those on that map."})
    previews = Boolean(load_default=False, metadata={"description": "Whether small pictures come with them."})


class MissionDeleteQuery(Schema):
    """Whether a mission is deleted permanently."""

    forever = Boolean(load_default=False, metadata={"description": "For good; only missions in the bin."})


class StartIn(Schema):
    """Origin of the robot's frame, and heading of its x axis."""

    lat = Float(required=True, validate=Range(-90, 90))
    lon = Float(required=True, validate=Range(-180, 180))
    heading_deg = Float(
        load_default=90.0,
        validate=Range(-360, 360),
        metadata={"description": "Clockwise from north; by default the robot looks east."},
    )


class MissionChange(Schema):
    """Changes of a mission; fields that are not sent stay."""

    name = String(validate=LATER)
    map = String(
        allow_none=True, validate=LATER, metadata={"description": "Slug of its map; null: on the globe."}
    )
    start = Nested(StartIn, allow_none=True)
    note = String(validate=Length(max=missions.MAX_NOTE))
    silent_after_s = Float(
        allow_none=True,
        allow_nan=False,
        validate=Range(LEAST_SILENT_S, MOST_SILENT_S),
        metadata={"description": "Seconds after which a robot that is not heard is silent; null: no alarm."},
    )
    keep = Boolean(metadata={"description": "true: its tracks are never thinned."})


class NewMission(MissionChange):
    """A mission to be created."""

    name = String(required=True, validate=LATER, metadata={"example": "Yard, first round"})


@blueprint.get("")
@blueprint.input(MissionListQuery, location="query", arg_name="query")
@blueprint.output(MissionList)
def list_missions(query: dict[str, Any]) -> dict[str, Any]:
    """List the missions that you may see; in pages if a `limit` is given."""
    who, map_ = account(), query["map"]
    map_id = None if map_ is None else open_map(map_, binned=True).id
    part = missions.MissionListPart(map_id=map_id, **wanted_part(query))
    with library().database.read() as session:
        shown, last = split(missions.list_missions(session, who, part=part), query["limit"])
        drawn = preview_missions(session, shown) if query["previews"] else [None] * len(shown)
        listed = [
            {**state.entry_json(entry), "preview": None if preview is None else _preview_json(preview)}
            for entry, preview in zip(shown, drawn, strict=True)
        ]
        return {"missions": listed, "next": None if last is None else last.cursor.text()}


@blueprint.post("")
@blueprint.input(NewMission, arg_name="data")
@blueprint.output(MissionSummary, status_code=201)
def create(data: dict[str, Any]) -> dict[str, Any]:
    """Create a mission without tracks; on a map, this needs the role of an editor."""
    who, map_id = account(), _map_id(data.get("map"))
    with library().database.write() as session:
        mission = missions.create(
            session,
            data["name"],
            account_id=who.id,
            map_id=map_id,
            start=data.get("start"),
            note=data.get("note", ""),
        )
        mission.keep = data.get("keep", False)
        mission.silent_after_s = data.get("silent_after_s")
        return state.summary(session, mission, account=who)


@blueprint.get(f"/{_ID}")
@blueprint.doc(responses=json_answer("The state of a mission.", MissionState))
def show(mission_id: int) -> dict[str, Any]:
    """Get a mission without its poses, objects and photos."""
    mission, who = open_mission(mission_id, binned=True), account()
    with library().database.read() as session:
        return state.whole(session, session.get_one(Mission, mission.id), account=who)


@blueprint.patch(f"/{_ID}")
@mission_role("editor")
@blueprint.input(MissionChange, arg_name="data")
@blueprint.output(MissionSummary)
def change(mission_id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Change a mission's name, note, start or mark; owners can also move it to another map."""
    mission, who = open_mission(mission_id, "owner" if "map" in data else "editor"), account()
    map_id = _map_id(data.get("map"))
    with library().database.write() as session:
        row = session.get_one(Mission, mission.id)
        row.name = missions.checked_name(data.get("name", row.name))
        row.note = missions.checked_note(data.get("note", row.note))
        row.start = data.get("start", row.start)
        row.keep = data.get("keep", row.keep)
        row.silent_after_s = data.get("silent_after_s", row.silent_after_s)
        if "map" in data and map_id != row.map_id:
            if map_id is not None and shares.list_shares(session, row):
                # Links to the mission show the image of its map, and only the map's owners may share that.
                maps.find(session, data["map"], account=who, role="owner")
            row.map_id = map_id
        missions.count_change(row)
        return state.summary(session, row, account=who)


@blueprint.delete(f"/{_ID}")
@blueprint.input(MissionDeleteQuery, location="query", arg_name="query")
@blueprint.output(MissionSummary)
def put_into_bin(mission_id: int, query: dict[str, Any]) -> dict[str, Any]:
    """Move a mission to the bin, from which it can be restored; or delete one there permanently."""
    if not query["forever"]:
        return _binned(mission_id, into=True)
    mission, who = open_mission(mission_id, "owner", binned=True), account()
    with library().database.write() as session:
        row = session.get_one(Mission, mission.id)
        delete.queue(session, row, account_id=who.id)
        return state.summary(session, row, account=who)


@blueprint.post(f"/{_ID}/restore")
@blueprint.output(MissionSummary)
def restore(mission_id: int) -> dict[str, Any]:
    """Restore a mission from the bin."""
    return _binned(mission_id, into=False)


def _binned(mission_id: int, *, into: bool) -> dict[str, Any]:
    mission, who = open_mission(mission_id, "owner", binned=True), account()
    with library().database.write() as session:
        row = missions.find(session, mission.id, account=who, role="owner")
        (missions.put_into_bin if into else missions.take_from_bin)(row)
        return state.summary(session, row, account=who)


def _preview_json(preview: MissionPreview) -> dict[str, Any]:
    digits = 0 if max(preview.size) > _FINE else 2
    line, dots = np.round(preview.line, digits).tolist(), np.round(preview.dots, digits).tolist()
    return {
        "image": _thumbnail(preview.map),
        "width": preview.size[0],
        "height": preview.size[1],
        "line": "M" + "L".join(f"{x:g} {y:g}" for x, y in line) if line else "",
        "dots": "".join(f"M{x:g} {y:g}h0" for x, y in dots),
    }


def _thumbnail(record: MapRecord | None) -> str | None:
    if record is None:
        return None
    return f"/api/v1/maps/{record.slug}/thumbnail?v={record.satellite_revision}"


def _map_id(slug: str | None) -> int | None:
    """Return the id of a map on which the caller may create missions."""
    return None if slug is None else open_map(slug, "editor").id
