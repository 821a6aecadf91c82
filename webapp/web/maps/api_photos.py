"""API of photos: add them, upload them in chunks, get previews and original files.

A chunked upload is begun and sent, and the photo is added after the last chunk. A chunk that was acknowledged
is on the disk. A client that lost a response asks for the offset and resumes there; one that lost all its
state begins again with the same fingerprint and gets the offset of the stored bytes.
"""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, File, Integer, List, Nested, String
from apiflask.validators import Length, Range
from flask import Response, request
from werkzeug.datastructures import FileStorage

from webapp.errors import DiskFull, ExpMapError, InputError, PhotoError, UsageError
from webapp.extras import require
from webapp.files.part_file import (
    WrongOffset,
    append,
    arrived,
    check_space,
    discard,
    one_at_a_time,
    receive,
)
from webapp.files.photos.photo import Kind
from webapp.files.photos.sidecars import Sidecar, Sidecars, is_sidecar
from webapp.files.photos.xmp import MAX_BYTES
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo, Upload
from webapp.tasks.maps import add_photo, pictures
from webapp.tasks.maps.add_photo import AddedPhoto, IncomingPhoto
from webapp.tasks.video.add_video import is_clip, is_track
from webapp.web import chunks
from webapp.web.context import account, library, map_role, open_map, reading_map, settings
from webapp.web.errors import as_json
from webapp.web.fields import BoundedList
from webapp.web.maps import state
from webapp.web.maps.schemas import PageQuery, PhotoPage
from webapp.web.openapi import file_answer, json_answer
from webapp.web.sending import send_original, send_picture

photos_api = APIBlueprint("api_photos", __name__, url_prefix="/api/v1/maps/<slug>/photos", tag="Photos")
uploads_api = APIBlueprint("api_uploads", __name__, url_prefix="/api/v1/maps/<slug>/uploads", tag="Uploads")

_OTHER_PARTS = 20
_MOST_FILES = 10_000
"""Of the schema; `upload.files_per_request` limits them further."""
"""Allowance for form fields other than files."""
_MOST_BESIDE = 150_000
"""Characters of a file beside a photo that is sent with an upload."""
_MOST_BESIDE_BYTES = 20_000_000
"""Of all files beside the photos of a request, which are in memory together."""


class ErrorOut(Schema):
    """Reason for rejecting a file."""

    code = String()
    message = String()
    hint = String(allow_none=True)
    where = String(allow_none=True)


class IntakeOut(Schema):
    """The result for a file: a photo, or an error."""

    name = String()
    id = Integer(metadata={"description": "of the photo in the map"})
    placed = Boolean()
    duplicate = Boolean(metadata={"description": "the map had this photo already"})
    gps_problem = String(
        allow_none=True, metadata={"description": "why it was not placed by its GPS, for people"}
    )
    job = Integer(allow_none=True, metadata={"description": "that takes it into the index"})
    notes = List(
        String(),
        metadata={"description": "about its file: where its position is from, what was left out"},
    )
    is_plan = Boolean(
        metadata={"description": "it looks like a plan or satellite image, which may be the map's image"}
    )
    belongs_to = String(
        metadata={"description": "of a file beside a photo: the name of the photo that it was read for"}
    )
    error = Nested(ErrorOut)


class PhotosIn(Schema):
    """Photos to add."""

    file = BoundedList(
        File(),  # type: ignore[no-untyped-call]
        required=True,
        most=_MOST_FILES,
        metadata={
            "description": "repeated: one for each photo, and for the `.xmp` and JSON of Google beside photos"
        },
    )


def intake_json(intake: AddedPhoto) -> dict[str, Any]:
    """Return the result for a file as JSON."""
    return {
        "name": intake.name,
        "id": intake.id,
        "placed": intake.placed,
        "duplicate": intake.duplicate,
        "gps_problem": intake.gps_problem,
        "job": intake.job,
        "notes": list(intake.notes),
        "is_plan": intake.is_plan,
    }


@photos_api.before_request
def limit_parts() -> None:
    """Limit the number of form parts, which is enforced while the request is read."""
    request.max_form_parts = settings().upload.files_per_request + _OTHER_PARTS


@photos_api.get("")
@photos_api.input(PageQuery, location="query", arg_name="query")
@photos_api.doc(responses=json_answer("Some photos, by id.", PhotoPage))
def list_photos(slug: str, query: dict[str, int]) -> dict[str, Any]:
    """List photos in pages."""
    with reading_map(slug, binned=True) as (session, record):
        return state.photos_after(session, record, query["after"], most=query["limit"])


@photos_api.post("")
@map_role("editor")
@photos_api.input(PhotosIn, location="files", arg_name="given")
@photos_api.output(IntakeOut(many=True), status_code=207, description="One result for each file, in order")
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
    names = [add_photo.tidy_name(file.filename or "") for file in given["file"]]
    beside = _read_beside(names, given["file"])
    photo_of = Sidecars(names).photo_of
    return [
        _take_in(record, file, name=name, beside=tuple(beside.values()))
        if name not in beside
        else _beside(name, photo_of(name))
        for name, file in zip(names, given["file"], strict=True)
    ]


def _read_beside(names: list[str], files: list[FileStorage]) -> dict[str, Sidecar]:
    """Read the files beside the photos of a request, by name."""
    found: dict[str, Sidecar] = {}
    left = _MOST_BESIDE_BYTES
    for name, file in zip(names, files, strict=True):
        if not is_sidecar(name):
            continue
        if name in found:
            hint = "send photos of the same name, with the files beside them, in requests of their own"
            raise UsageError("two files beside photos have this name", where=name, hint=hint)
        data = file.stream.read(MAX_BYTES + 1)
        left -= len(data)
        if left < 0:
            raise UsageError(
                f"the files beside photos have more than {_MOST_BESIDE_BYTES // 10**6} MB in all",
                where=name,
                hint="send fewer photos in a request",
            )
        found[name] = Sidecar(name, data)
    return found


def _beside(name: str, photo: str | None) -> dict[str, Any]:
    """Return the result for a file beside a photo."""
    if photo is not None:
        return {"name": name, "placed": False, "belongs_to": photo}
    error = PhotoError(
        "no photo of the request belongs to it", where=name, hint="send it together with its photo"
    )
    return {"name": name, "placed": False, "error": as_json(error)}


@photos_api.get("/<id:id>/thumb")
@photos_api.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def thumb(slug: str, id: int) -> Response:
    """Get a thumbnail of a photo."""
    return _preview(slug, id, "thumb")


@photos_api.get("/<id:id>/preview")
@photos_api.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def preview(slug: str, id: int) -> Response:
    """Get a preview of a photo, large enough to fill a screen."""
    return _preview(slug, id, "preview")


@photos_api.get("/<id:id>/original")
@photos_api.doc(responses=file_answer("The original file.", "image/*"))
def original(slug: str, id: int) -> Response:
    """Get the original file of a photo."""
    record, photo = _find(slug, id)
    file = pictures.file_of(library(), record.slug, photo=photo)
    return send_original(file, photo.name, audience="members")


def _take_in(
    record: MapRecord, file: FileStorage, *, name: str, beside: tuple[Sidecar, ...]
) -> dict[str, Any]:
    part = library().uploads / f"{secrets.token_hex(16)}.part"
    try:
        receive(part, file.stream, max_bytes=int(settings().photo.max_mb * 1e6))
        photo = IncomingPhoto(part, name, beside=beside)
        return intake_json(add_photo.add_photo(library(), record.id, photo=photo, settings=settings()))
    except ExpMapError as error:
        return {"name": name, "placed": False, "error": as_json(error)}
    finally:
        discard(part)


def _find(slug: str, id: int) -> tuple[MapRecord, Photo]:
    with reading_map(slug, binned=True) as (session, record):
        return record, maps.photo(session, record, id)


def _preview(slug: str, id: int, kind: Kind) -> Response:
    record, photo = _find(slug, id)
    file = pictures.file_of(library(), record.slug, photo=photo)
    return send_picture(file, kind=kind, audience="members", changes_url=True)


class BesideIn(Schema):
    """A file beside a photo."""

    name = String(required=True, validate=Length(max=500))
    content = String(required=True, validate=Length(max=_MOST_BESIDE))


class UploadIn(Schema):
    """The file to upload."""

    name = String(required=True, validate=Length(max=2000))
    size_bytes = Integer(required=True, strict=True, validate=Range(min=0))
    fingerprint = String(
        required=True,
        validate=Length(min=1, max=500),
        metadata={"description": "the same for the same file: made of name, size and time, say"},
    )
    beside = BoundedList(
        Nested(BesideIn),
        most=3,
        load_default=list,
        metadata={
            "description": "Files beside the photo, by their names: `.xmp`, and the JSON of Google Takeout. "
            "What does not belong to it is ignored."
        },
    )


class UploadOut(Schema):
    """State of an upload."""

    id = String()
    offset = Integer(metadata={"description": "bytes that have arrived: where to resume"})
    size_bytes = Integer()
    chunk_bytes = Integer(metadata={"description": "largest chunk"})


class ChunkOut(IntakeOut):
    """State of an upload; with the last chunk also the result for the file."""

    offset = Integer()


uploads_api.before_request(chunks.limit_bytes)
uploads_api.errorhandler(WrongOffset)(chunks.offset_response)


@uploads_api.post("")
@map_role("editor")
@uploads_api.input(UploadIn, arg_name="given")
@uploads_api.output(UploadOut, status_code=201)
def begin(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Begin the upload of a photo, or get the state of an existing one."""
    record, who = open_map(slug, "editor"), account()
    _check_size(given["name"], given["size_bytes"])
    with library().database.write() as session:
        row = session.get_one(MapRecord, record.id, with_for_update=True)
        upload = maps.begin_upload(session, row, account_id=who.id, file=maps.Announced(**given))
        most = settings().upload.open_per_account
        if maps.count_open_uploads(session, account_id=who.id) > most:
            raise UsageError(f"{most} uploads are unfinished", hint="finish or cancel some of them first")
    return _state(upload)


@uploads_api.get("/<id>")
@uploads_api.output(UploadOut)
def look(slug: str, id: str) -> dict[str, Any]:
    """Get the state of an upload."""
    return _state(find_upload(open_map(slug, "editor"), id))


@uploads_api.patch("/<id>")
@uploads_api.output(ChunkOut)
@uploads_api.doc(
    description="The body is the chunk, its place the header `Upload-Offset`. A chunk that does not fit is "
    "answered by 409 with the right `offset`. The last chunk is answered by the result for the file, for a "
    "video or its track by the offset alone: `POST /videos` takes them; where "
    "all bytes have arrived and that answer did not come, an empty chunk at the end asks for it."
)
def send(slug: str, id: str) -> dict[str, Any]:
    """Send the next chunk."""
    record = open_map(slug, "editor")
    upload = find_upload(record, id)
    offset, data, part = chunks.given_offset(), request.get_data(cache=False), part_of(upload)
    with one_at_a_time(part):
        try:
            there = append(part, data, offset=offset, size=upload.size_bytes)
            if there < upload.size_bytes or is_clip(upload.name) or is_track(upload.name):
                return {"offset": there}
            beside = [Sidecar(one["name"], one["content"].encode()) for one in upload.beside or ()]
            incoming = IncomingPhoto(part, upload.name, upload.photo_id, beside=tuple(beside))
            intake = add_photo.add_photo(library(), record.id, photo=incoming, settings=settings())
        except (InputError, DiskFull):
            _give_up(upload)
            raise
        _give_up(upload)
    return {"offset": there, **intake_json(intake)}


@uploads_api.delete("/<id>")
@uploads_api.output({}, status_code=204)
def give_up(slug: str, id: str) -> str:
    """Cancel an upload and delete its received bytes."""
    upload = find_upload(open_map(slug, "editor"), id)
    with one_at_a_time(part_of(upload)):
        _give_up(upload)
    return ""


def find_upload(record: MapRecord, id: str) -> Upload:
    """Find an upload of the caller. Raises NotFound."""
    with library().database.read() as session:
        return maps.find_upload(session, id, map_id=record.id, account_id=account().id)


def part_of(upload: Upload) -> Path:
    """Return the path of the received bytes, named by the id that the server has chosen."""
    return library().uploads / f"{upload.id}.part"


def _state(upload: Upload) -> dict[str, Any]:
    return {
        "id": upload.id,
        "offset": arrived(part_of(upload)),
        "size_bytes": upload.size_bytes,
        "chunk_bytes": chunks.chunk_bytes(),
    }


def _check_size(name: str, size_bytes: int) -> None:
    """Fail early if the complete file would be rejected for its size."""
    where, most = add_photo.tidy_name(name), settings().photo.max_mb
    if is_clip(name):
        require("video")
        most = settings().upload.video_mb
    if size_bytes == 0:
        raise PhotoError("it is empty", where=where, hint="copy it from the camera again")
    if size_bytes > most * 1e6:
        raise PhotoError(
            f"it has {size_bytes / 1e6:.0f} MB, more than the limit of {most:g}",
            where=where,
            hint="cut it on your computer: expmap map cut-video" if is_clip(name) else "scale it down",
        )
    check_space(library().uploads, size_bytes, reserve_mb=settings().upload.reserve_mb)


def _give_up(upload: Upload) -> None:
    """Delete the record, then the remaining bytes."""
    with library().database.write() as session:
        maps.finish_upload(session, upload.id)
    discard(part_of(upload))
