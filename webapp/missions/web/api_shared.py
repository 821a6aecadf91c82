"""API of shared missions, for visitors: access by the token in the address, without a sign-in."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Integer, List, Nested, String
from apiflask.validators import Range
from flask import Response

from webapp.errors import NotFound
from webapp.files.photos.photo import Kind
from webapp.missions.store import drawings as mission_drawings
from webapp.missions.store import missions, reading, shares, tracks
from webapp.missions.store import objects as mission_objects
from webapp.missions.tasks import add_photo
from webapp.missions.web import context, state
from webapp.missions.web.api_drawings import CoverageOut, DrawingList, coverage_json, drawing_json
from webapp.missions.web.api_missions import MissionSatelliteOut, TrackOut
from webapp.missions.web.api_objects import ObjectHistory, ObjectOut, change_json
from webapp.missions.web.api_tracks import (
    LineOut,
    LineQuery,
    ProfileOut,
    ProfileQuery,
    line_json,
    profile_json,
)
from webapp.store.schema import MapRecord
from webapp.tasks.satellite import display
from webapp.web.context import library, public, settings
from webapp.web.fields import RecordNumber
from webapp.web.openapi import file_answer
from webapp.web.sending import send_picture
from webapp.web.sharing.shared_state import send_display

blueprint = APIBlueprint(
    "api_shared_missions", __name__, url_prefix="/api/v1/shared-missions/<token>", tag="Shared"
)
blueprint.record(context.allow_any_text)

_TRACK = "<id:track_id>"
_SHA = "<string(length=64):sha256>"
_MOST = 2000


class SharedMissionOut(Schema):
    """A shared mission without its poses, objects and photos."""

    id = Integer()
    name = String()
    revision = Integer(metadata={"description": "Counts the changes."})
    ended_at = String(allow_none=True)
    drawings_revision = Integer(metadata={"description": "Another number means that drawings changed."})
    tracks = List(Nested(TrackOut))
    objects = Integer()
    photos = Integer(metadata={"description": "0 where none are shown."})
    satellite = Nested(MissionSatelliteOut, allow_none=True)
    cursor = String(metadata={"description": "Another text means that something is new."})


class SharedObjectsQuery(Schema):
    """Filter and page of the list of objects."""

    since = RecordNumber(least=-1, load_default=-1, metadata={"description": "Changed after that revision."})
    limit = Integer(load_default=1000, validate=Range(1, _MOST))
    offset = RecordNumber(load_default=0)


class SharedObjects(Schema):
    """Objects, ordered by id."""

    objects = List(Nested(ObjectOut))


class SharedPhotoOut(Schema):
    """A photo of a shared mission."""

    sha256 = String()
    width = Integer()
    height = Integer()
    object = String(allow_none=True)
    fix = Dict(allow_none=True, metadata={"description": "Where it was taken, as far as the map knows."})
    url = String(metadata={"description": "Address of a picture of at most 1600 x 1600 pixels."})
    thumb = String(metadata={"description": "Address of a picture of at most 256 x 256 pixels."})


class SharedPhotos(Schema):
    """The photos that the share shows."""

    photos = List(Nested(SharedPhotoOut))


@blueprint.get("")
@public
@blueprint.output(SharedMissionOut)
def show(token: str) -> dict[str, Any]:
    """Get a shared mission without its poses, objects and photos."""
    with library().database.read() as session:
        return state.shared_mission(session, shares.open_share(session, token), token=token)


@blueprint.get(f"/tracks/{_TRACK}/line")
@public
@blueprint.input(LineQuery, location="query", arg_name="query")
@blueprint.output(LineOut)
def line(token: str, track_id: int, *, query: dict[str, Any]) -> dict[str, Any]:
    """Get a track, or the part of it in a box, as a line."""
    with library().database.read() as session:
        mission = shares.open_share(session, token).mission
        return line_json(session, tracks.find(session, mission.id, track_id), query)


@blueprint.get(f"/tracks/{_TRACK}/profile")
@public
@blueprint.input(ProfileQuery, location="query", arg_name="query")
@blueprint.output(ProfileOut)
def profile(token: str, track_id: int, *, query: dict[str, Any]) -> dict[str, Any]:
    """Get distance, speed and height of a track over time."""
    with library().database.read() as session:
        mission = shares.open_share(session, token).mission
        return profile_json(session, tracks.find(session, mission.id, track_id), query)


@blueprint.get("/objects")
@public
@blueprint.input(SharedObjectsQuery, location="query", arg_name="query")
@blueprint.output(SharedObjects)
def objects(token: str, query: dict[str, int]) -> dict[str, Any]:
    """List objects of a shared mission."""
    with library().database.read() as session:
        opened = shares.open_share(session, token)
        rows = reading.some_objects(session, opened.mission.id, **query)
        return {"objects": [state.shared_object(opened, row) for row in rows]}


@blueprint.get("/objects/<text:object_id>", merge_slashes=False)
@public
@blueprint.output(ObjectHistory)
def one_object(token: str, object_id: str) -> dict[str, Any]:
    """Get an object with its sightings and changes of state."""
    with library().database.read() as session:
        opened = shares.open_share(session, token)
        row = missions.find_object(session, opened.mission.id, object_id)
        seen = missions.sightings(session, opened.mission.id, object_id)
        history = [state.shared_sighting(opened, one) for one in seen]
        changes = mission_objects.changes(session, opened.mission.id, object_id)
        states = [{**change_json(one), "by": None, "note": ""} for one in changes]
        return {**state.shared_object(opened, row), "sightings": history, "changes": states}


@blueprint.get("/drawings")
@public
@blueprint.output(DrawingList)
def drawings(token: str) -> dict[str, Any]:
    """List the search areas, lines and markers of a shared mission."""
    with library().database.read() as session:
        mission = shares.open_share(session, token).mission
        found = mission_drawings.list_drawings(session, mission.id)
    return {"drawings": [drawing_json(row, visitor=True) for row in found]}


@blueprint.get("/coverage")
@public
@blueprint.output(CoverageOut)
def coverage(token: str) -> dict[str, Any]:
    """Get how much of each search area the tracks have covered."""
    with library().database.read() as session:
        mission = shares.open_share(session, token).mission
    return coverage_json(mission.id)


@blueprint.get("/photos")
@public
@blueprint.output(SharedPhotos)
def photos(token: str) -> dict[str, Any]:
    """List the photos that the share shows."""
    with library().database.read() as session:
        found = state.shared_photos(session, shares.open_share(session, token))
        return {"photos": [state.shared_photo(token, photo) for photo in found]}


@blueprint.get(f"/photos/{_SHA}/thumb")
@public
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def photo_thumb(token: str, sha256: str) -> Response:
    """Get a thumbnail of a photo."""
    return _photo(token, sha256, "thumb")


@blueprint.get(f"/photos/{_SHA}/preview")
@public
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def photo_preview(token: str, sha256: str) -> Response:
    """Get a preview of a photo."""
    return _photo(token, sha256, "preview")


@blueprint.get("/satellite")
@public
@blueprint.doc(responses=file_answer("The image, or a smaller copy of a large one.", "image/*"))
def image(token: str) -> Response:
    """Get the image of the mission's map."""
    return send_display(display.copy(library(), _map(token), settings=settings()))


@blueprint.get("/satellite/tiles/<int:z>/<int:x>/<int:y>")
@public
@blueprint.doc(responses=file_answer("A tile of 256 x 256 pixels.", "image/*"))
def tile(token: str, *, z: int, x: int, y: int) -> Response:
    """Get a tile of a large image."""
    return send_display(display.tile(library(), _map(token), z=z, x=x, y=y))


def _map(token: str) -> MapRecord:
    with library().database.read() as session:
        map_id = shares.open_share(session, token).mission.map_id
        if map_id is None:
            raise NotFound("the mission is not on a map")
        return session.get_one(MapRecord, map_id)


def _photo(token: str, sha256: str, kind: Kind) -> Response:
    with library().database.read() as session:
        photo = state.find_shared_photo(session, shares.open_share(session, token), sha256=sha256)
    file = add_photo.file_of(library(), photo)
    return send_picture(file, kind=kind, audience="visitors")
