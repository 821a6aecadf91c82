"""Photos through the API: several in a request, each one back as a picture or file, what is blurred."""

from __future__ import annotations

import mimetypes
import secrets
from pathlib import Path, PurePosixPath
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, File, Integer, List, Nested, String
from apiflask.validators import Length
from flask import Response, request, send_file
from werkzeug.datastructures import FileStorage

from webapp.core.blur import BlurBox
from webapp.errors import ExpMapError, UsageError
from webapp.files.part_file import discard, receive
from webapp.files.photos.preview import Kind
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import add_photo, show_photo
from webapp.tasks.maps.add_photo import Intake
from webapp.tasks.sharing import blur_photo
from webapp.web.context import account, library, open_map, settings
from webapp.web.errors import as_json
from webapp.web.maps import state
from webapp.web.maps.schemas import BoxOut, EditAnswer
from webapp.web.openapi import file_answer

blueprint = APIBlueprint("api_photos", __name__, url_prefix="/api/v1/maps/<slug>/photos", tag="Photos")

_OTHER_PARTS = 20
"""Fields of a form beside its files."""

blur_api = APIBlueprint("api_blur", __name__, url_prefix="/api/v1/maps/<slug>/photos", tag="Photos")


class ErrorOut(Schema):
    """Why a file was refused."""

    code = String()
    message = String()
    hint = String(allow_none=True)
    where = String(allow_none=True)


class IntakeOut(Schema):
    """What became of a file: a photo, or an error."""

    name = String()
    id = Integer(metadata={"description": "of the photo in the map"})
    placed = Boolean()
    duplicate = Boolean(metadata={"description": "the map had this photo already"})
    gps_problem = String(
        allow_none=True, metadata={"description": "why it was not placed by its GPS, for people"}
    )
    job = Integer(allow_none=True, metadata={"description": "that takes it into the index"})
    error = Nested(ErrorOut)


class PhotosIn(Schema):
    """Photos."""

    file = List(
        File(),  # type: ignore[no-untyped-call]
        required=True,
        metadata={"description": "repeated: one for each photo"},
    )


def intake_json(intake: Intake) -> dict[str, Any]:
    """Return what was done with a file."""
    return {
        "name": intake.name,
        "id": intake.id,
        "placed": intake.placed,
        "duplicate": intake.duplicate,
        "gps_problem": intake.gps_problem,
        "job": intake.job,
    }


@blueprint.before_request
def limit_parts() -> None:
    """Refuse requests of very many parts while they are read."""
    request.max_form_parts = settings().upload.files_per_request + _OTHER_PARTS


@blueprint.post("")
@blueprint.input(PhotosIn, location="files", arg_name="given")
@blueprint.output(IntakeOut(many=True), status_code=207, description="One result for each file, in order")
def add(slug: str, given: dict[str, list[FileStorage]]) -> list[dict[str, Any]]:
    """Add photos."""
    record = open_map(slug, "editor")
    most = settings().upload.files_per_request
    if not 0 < len(given["file"]) <= most:
        raise UsageError(
            f"{len(given['file'])} files in one request",
            where="file",
            hint=f"send 1 to {most}, or one by one",
        )
    return [_take_in(record, file) for file in given["file"]]


@blueprint.get("/<int(max=2147483647):id>/thumb")
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/jpeg"))
def thumb(slug: str, id: int) -> Response:
    """Get a photo as a small picture."""
    return _preview(slug, id, "thumb")


@blueprint.get("/<int(max=2147483647):id>/preview")
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def preview(slug: str, id: int) -> Response:
    """Get a photo as a picture that fills a screen."""
    return _preview(slug, id, "preview")


@blueprint.get("/<int(max=2147483647):id>/original")
@blueprint.doc(responses=file_answer("The file as it came.", "image/*"))
def original(slug: str, id: int) -> Response:
    """Get the file of a photo as it came."""
    record, photo = _find(slug, id)
    path = show_photo.original(library(), record.slug, photo=photo)
    response = _lasting(path, etag=photo.sha256)
    last = PurePosixPath(photo.name.replace("\\", "/")).name
    response.headers.set("Content-Disposition", "attachment", filename=last or path.name)
    return response


def _take_in(record: MapRecord, file: FileStorage) -> dict[str, Any]:
    name = add_photo.tidy_name(file.filename or "")
    part = library().uploads / f"{secrets.token_hex(16)}.part"
    try:
        receive(part, file.stream, max_bytes=int(settings().photo.max_mb * 1e6))
        return intake_json(
            add_photo.add_photo(library(), record.id, source=part, name=name, settings=settings())
        )
    except ExpMapError as error:
        return {"name": name, "placed": False, "error": as_json(error)}
    finally:
        discard(part)


def _find(slug: str, id: int) -> tuple[MapRecord, Photo]:
    record = open_map(slug, binned=True)
    with library().database.read() as session:
        return record, maps.photo(session, record, id)


def _preview(slug: str, id: int, kind: Kind) -> Response:
    record, photo = _find(slug, id)
    path = show_photo.preview(library(), record.slug, photo=photo, kind=kind, settings=settings())
    return _lasting(path, etag=f"{photo.sha256}-{kind}-{show_photo.look_of(photo)}")


def _lasting(path: Path, *, etag: str) -> Response:
    """Send a file that never changes under its address."""
    kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    response = send_file(path, mimetype=kind, etag=etag, conditional=True)
    response.headers["Cache-Control"] = "private, max-age=31536000, immutable"
    return response


class BlurIn(Schema):
    """All that is to be blurred; nothing for the photo as it is."""

    boxes = List(Nested(BoxOut), required=True, validate=Length(max=blur_photo.MOST_BOXES))


@blur_api.put("/<int(max=2147483647):id>/blur")
@blur_api.input(BlurIn, arg_name="wish")
@blur_api.output(EditAnswer)
def blur(slug: str, id: int, wish: dict[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Blur parts of a photo in every picture of it; its file stays as it came, and visitors never get it."""
    record = open_map(slug, "editor")
    boxes = [BlurBox(**box) for box in wish["boxes"]]
    revision = blur_photo.blur_photo(library(), record.id, photo_id=id, boxes=boxes, settings=settings())
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        return state.edited(session, row, account=account(), revision=revision)
