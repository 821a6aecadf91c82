"""API of the photos of a mission."""

from __future__ import annotations

import secrets
from pathlib import PurePosixPath
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Float, Integer, List, Nested, String
from apiflask.validators import Length, Predicate, Range
from flask import Response, request, url_for

from webapp.files.part_file import check_space, discard, receive
from webapp.files.photos.photo import Kind
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission, MissionPhoto
from webapp.missions.tasks import add_photo, localize_photos
from webapp.missions.tasks.add_photo import PhotoMetadata
from webapp.missions.web.context import mission_role, open_mission
from webapp.web.context import account, library, settings
from webapp.web.fields import Boolean
from webapp.web.json_bodies import limit_photo
from webapp.web.openapi import file_answer
from webapp.web.sending import send_original, send_picture

blueprint = APIBlueprint(
    "api_mission_photos",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>/photos",
    tag="Missions",
)
blueprint.before_request(limit_photo)

_FAR = 1e12
_SHA = "<string(length=64):sha256>"


class PhotoIn(Schema):
    """A photo and its metadata."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    time = Float(validate=Range(-_FAR, _FAR), metadata={"description": "When it was taken, Unix seconds."})
    object = String(
        validate=[Length(1, 200), Predicate("isprintable")],
        metadata={"description": "Id of the object of the mission that it shows."},
    )


class AddQuery(Schema):
    """Further processing of a new photo."""

    fix = Boolean(load_default=False, metadata={"description": "Localize it on the mission's map, soon."})


class MissionPhotoOut(Schema):
    """A photo of a mission."""

    sha256 = String()
    name = String(metadata={"description": "Name of the original file."})
    width = Integer()
    height = Integer()
    time_s = Float(allow_none=True)
    object = String(allow_none=True)
    fix = Dict(
        allow_none=True, metadata={"description": "Result of the localization, as in `localize --json`."}
    )
    fix_state = String(allow_none=True, metadata={"enum": ["queued", "done", "failed", None]})
    url = String(metadata={"description": "Address of a picture of at most 1600 x 1600 pixels."})
    thumb = String(metadata={"description": "Address of a picture of at most 256 x 256 pixels."})


class MissionPhotoList(Schema):
    """The photos of a mission, ordered by time."""

    photos = List(Nested(MissionPhotoOut))


def photo_json(photo: MissionPhoto) -> dict[str, Any]:
    """Return a photo as JSON; the fields of `MissionPhotoOut`."""

    def address(size: str) -> str:
        endpoint = f"api_mission_photos.{size}"
        return url_for(endpoint, mission_id=photo.mission_id, sha256=photo.sha256)

    return {
        "sha256": photo.sha256,
        "name": photo.name,
        "width": photo.width,
        "height": photo.height,
        "time_s": photo.time_s,
        "object": photo.object_id,
        "fix": photo.fix,
        "fix_state": photo.fix_state,
        "url": address("preview"),
        "thumb": address("thumb"),
    }


@blueprint.get("")
@blueprint.output(MissionPhotoList)
def listed(mission_id: int) -> dict[str, Any]:
    """List the photos of a mission."""
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        return {"photos": [photo_json(photo) for photo in missions.photos(session, mission.id)]}


@blueprint.post("")
@mission_role("editor")
@blueprint.input(PhotoIn, location="form_and_files", arg_name="given")
@blueprint.input(AddQuery, location="query", arg_name="query")
@blueprint.output(MissionPhotoOut, status_code=201)
def add(mission_id: int, *, given: dict[str, Any], query: dict[str, Any]) -> dict[str, Any]:
    """Add a photo to a mission; a photo with the same content is stored only once."""
    mission, file = open_mission(mission_id, "editor"), given["file"]
    if query["fix"]:
        localize_photos.map_of(mission)
    check_space(library().uploads, request.content_length or 0, reserve_mb=settings().upload.reserve_mb)
    part = library().uploads / f"{secrets.token_hex(16)}.part"
    try:
        receive(part, file.stream, max_bytes=int(settings().photo.max_mb * 1e6))
        kept = add_photo.add_mission_photo(
            library(),
            mission.id,
            source=part,
            name=file.filename or "",
            about=PhotoMetadata(given.get("time"), given.get("object")),
            settings=settings(),
        )
    finally:
        discard(part)
    if query["fix"]:
        with library().database.write() as session:
            kept = missions.find_photo(session, mission.id, kept.sha256)
            row = session.get_one(Mission, mission.id)
            localize_photos.queue(session, row, photos=[kept], account_id=account().id)
    return photo_json(kept)


@blueprint.get(f"/{_SHA}/preview")
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def preview(mission_id: int, sha256: str) -> Response:
    """Get a preview of a photo."""
    return _preview(mission_id, sha256, "preview")


@blueprint.get(f"/{_SHA}/thumb")
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def thumb(mission_id: int, sha256: str) -> Response:
    """Get a thumbnail of a photo."""
    return _preview(mission_id, sha256, "thumb")


@blueprint.get(f"/{_SHA}/original")
@blueprint.doc(responses=file_answer("The original file.", "image/*"))
def original(mission_id: int, sha256: str) -> Response:
    """Get the original file of a photo."""
    photo = _find(mission_id, sha256)
    file = add_photo.file_of(library(), photo)
    return send_original(file, PurePosixPath(photo.path).name, audience="members")


def _find(mission_id: int, sha256: str) -> MissionPhoto:
    mission = open_mission(mission_id, binned=True)
    with library().database.read() as session:
        return missions.find_photo(session, mission.id, sha256)


def _preview(mission_id: int, sha256: str, kind: Kind) -> Response:
    photo = _find(mission_id, sha256)
    return send_picture(add_photo.file_of(library(), photo), kind=kind, audience="members")
