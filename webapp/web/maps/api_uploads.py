"""Resumable uploads of photos: begun, sent in pieces, taken in when the last piece is there.

A piece that was answered is on the disk. Who lost the answer asks for the offset and goes on from there; who
lost everything begins again with the same fingerprint and finds what has arrived.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, String
from apiflask.validators import Length, Range
from flask import Response, jsonify, request

from webapp.errors import DiskFull, InputError, PhotoError, UsageError
from webapp.files.part_file import WrongOffset, append, arrived, check_space, discard, one_at_a_time
from webapp.store.maps import uploads
from webapp.store.schema import MapRecord, Upload
from webapp.tasks.maps import add_photo
from webapp.web.context import account, library, open_map, settings
from webapp.web.errors import as_json
from webapp.web.maps.api_photos import IntakeOut, intake_json

blueprint = APIBlueprint("api_uploads", __name__, url_prefix="/api/v1/maps/<slug>/uploads", tag="Uploads")

_HEADER = "Upload-Offset"
_JSON_BYTES = 10_000


class UploadIn(Schema):
    """A file that is going to be sent."""

    name = String(required=True, validate=Length(max=2000))
    size_bytes = Integer(required=True, strict=True, validate=Range(min=0))
    fingerprint = String(
        required=True,
        validate=Length(min=1, max=500),
        metadata={"description": "the same for the same file: made of name, size and time, say"},
    )


class UploadOut(Schema):
    """How far an upload is."""

    id = String()
    offset = Integer(metadata={"description": "bytes that have arrived: where to go on"})
    size_bytes = Integer()
    chunk_bytes = Integer(metadata={"description": "largest piece"})


class PieceOut(IntakeOut):
    """How far an upload is; with the last piece also what became of the file."""

    offset = Integer()


@blueprint.before_request
def limit_bytes() -> None:
    """Refuse pieces that are too large while they are read."""
    request.max_content_length = _chunk_bytes() if request.method == "PATCH" else _JSON_BYTES


@blueprint.errorhandler(WrongOffset)
def tell_offset(error: WrongOffset) -> Response:
    """Return the offset at which to go on."""
    response = jsonify(error=as_json(error), offset=error.offset)
    response.status_code = 409
    response.headers[_HEADER] = str(error.offset)
    return response


@blueprint.post("")
@blueprint.input(UploadIn, arg_name="given")
@blueprint.output(UploadOut, status_code=201)
def begin(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Begin to send a photo, or find how far it has come."""
    record, who = open_map(slug, "editor"), account()
    _check_size(given["name"], given["size_bytes"])
    with library().database.write() as session:
        upload = uploads.begin(session, map_id=record.id, account_id=who.id, **given)
        most = settings().upload.open_per_account
        if uploads.count_open(session, account_id=who.id) > most:
            raise UsageError(f"{most} uploads are unfinished", hint="finish or cancel some of them first")
    return _state(upload)


@blueprint.get("/<id>")
@blueprint.output(UploadOut)
def look(slug: str, id: str) -> dict[str, Any]:
    """Ask how far an upload is."""
    return _state(_find(open_map(slug, "editor"), id))


@blueprint.patch("/<id>")
@blueprint.output(PieceOut)
@blueprint.doc(
    description="The body is the piece, its place the header `Upload-Offset`. A piece that does not fit is "
    "answered by 409 with the right `offset`. The last piece is answered by what became of the file; where "
    "all bytes have arrived and that answer did not come, an empty piece at the end asks for it."
)
def send(slug: str, id: str) -> dict[str, Any]:
    """Send the next piece."""
    record = open_map(slug, "editor")
    upload = _find(record, id)
    offset, data, part = _offset(), request.get_data(cache=False), _part(upload)
    with one_at_a_time(part):
        try:
            there = append(part, data, offset=offset, size=upload.size_bytes)
            if there < upload.size_bytes:
                return {"offset": there}
            intake = add_photo.add_photo(
                library(), record.id, source=part, name=upload.name, settings=settings()
            )
        except (InputError, DiskFull):
            _give_up(upload)
            raise
        _give_up(upload)
    return {"offset": there, **intake_json(intake)}


@blueprint.delete("/<id>")
@blueprint.output({}, status_code=204)
def give_up(slug: str, id: str) -> str:
    """Give an upload up: what has arrived is deleted."""
    upload = _find(open_map(slug, "editor"), id)
    with one_at_a_time(_part(upload)):
        _give_up(upload)
    return ""


def _find(record: MapRecord, id: str) -> Upload:
    with library().database.read() as session:
        return uploads.find(session, id, map_id=record.id, account_id=account().id)


def _part(upload: Upload) -> Path:
    """Name the file of what has arrived, by the id that the server chose."""
    return library().uploads / f"{upload.id}.part"


def _state(upload: Upload) -> dict[str, Any]:
    return {
        "id": upload.id,
        "offset": arrived(_part(upload)),
        "size_bytes": upload.size_bytes,
        "chunk_bytes": _chunk_bytes(),
    }


def _chunk_bytes() -> int:
    return int(settings().upload.chunk_mb * 1e6)


def _offset() -> int:
    given = request.headers.get(_HEADER, "")
    if not (given.isascii() and given.isdecimal() and len(given) < 16):
        raise UsageError(
            "the header with the offset of the chunk is missing",
            where=_HEADER,
            hint="send the number of bytes before the chunk",
        )
    return int(given)


def _check_size(name: str, size_bytes: int) -> None:
    """Refuse at once what would be refused at the end."""
    where, most = add_photo.tidy_name(name), settings().photo.max_mb
    if size_bytes == 0:
        raise PhotoError("it is empty", where=where, hint="copy it from the camera again")
    if size_bytes > most * 1e6:
        raise PhotoError(
            f"it has {size_bytes / 1e6:.0f} MB, more than the limit of {most:g}",
            where=where,
            hint="scale it down",
        )
    check_space(library().uploads, size_bytes, reserve_mb=settings().upload.reserve_mb)


def _give_up(upload: Upload) -> None:
    """Delete the record, then what is left of the bytes."""
    with library().database.write() as session:
        uploads.finish(session, upload.id)
    discard(_part(upload))
