"""API of the floors of a map: list, add, change, align and remove them, and get their images."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, List, Nested, String
from apiflask.validators import Length, Range
from flask import Response
from flask_babel import gettext
from werkzeug.datastructures import FileStorage

from webapp.core.geo.floors import BASE_FLOOR, LARGEST_LEVEL, MOST_FLOOR_NAME, Floor
from webapp.core.geo.types import MapPixel
from webapp.errors import UsageError
from webapp.files.part_file import receive, show_file_as
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.satellite import display, floors
from webapp.tasks.satellite.floors import MOST_PAIRS, NewFloor, align_floor
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import Boolean, BoundedList
from webapp.web.json_bodies import limit_image
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer, FloorOut
from webapp.web.openapi import file_answer
from webapp.web.sending import send_immutable

blueprint = APIBlueprint("api_floors", __name__, url_prefix="/api/v1/maps/<slug>/floors", tag="Floors")
blueprint.before_request(limit_image)

_limit = ConcurrencyLimit("images of floors", share=0.125)
blueprint.record(_limit.set_up)

_ID = "<id:id>"


class FloorIn(Schema):
    """Name and height of a floor."""

    name = String(validate=Length(1, MOST_FLOOR_NAME))
    level = Float(validate=Range(-LARGEST_LEVEL, LARGEST_LEVEL))
    height_m = Float(allow_none=True)


class NewFloorIn(FloorIn):
    """A new floor, with its image."""

    name = String(required=True, validate=Length(1, MOST_FLOOR_NAME))
    level = Float(required=True, validate=Range(-LARGEST_LEVEL, LARGEST_LEVEL))
    file = File(  # type: ignore[no-untyped-call]
        metadata={"description": "PNG, JPEG or TIFF; without one, the map's own image shows the floor."}
    )
    base_name = String(
        load_default=None,
        validate=Length(1, MOST_FLOOR_NAME),
        metadata={"description": "Name of the floor that the map's own image shows; for the first floor."},
    )
    base_level = Float(load_default=0.0, validate=Range(-LARGEST_LEVEL, LARGEST_LEVEL))


class FloorImageIn(Schema):
    """An image."""

    file = File(required=True)  # type: ignore[no-untyped-call]


class PairIn(Schema):
    """Current and desired position of a spot: x and y, map pixels."""

    shown = BoundedList(Float(), required=True, least=2, most=2)
    wanted = BoundedList(Float(), required=True, least=2, most=2)


class AlignIn(Schema):
    """Pairs of spots by which the image of a floor is aligned with the map."""

    pairs = BoundedList(Nested(PairIn), required=True, least=1, most=MOST_PAIRS)


class RemoveQuery(Schema):
    """Handling of the photos on the floor."""

    tray = Boolean(load_default=False, metadata={"description": "Put them into the tray."})


class FloorsOut(Schema):
    """The floors of a map."""

    floors = List(Nested(FloorOut), metadata={"description": "The lowest first."})


@blueprint.get("")
@blueprint.output(FloorsOut)
def show(slug: str) -> dict[str, Any]:
    """List the floors of the map; empty if it has only one image."""
    return {"floors": state.floors_json(open_map(slug))}


@blueprint.post("")
@map_role("editor")
@blueprint.input(NewFloorIn, location="form_and_files", arg_name="given")
@blueprint.output(EditAnswer, status_code=201)
def add(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Add a floor, as one step that can be undone."""
    record = open_map(slug, "editor")
    floor = Floor(BASE_FLOOR, given["name"].strip(), given["level"], given.get("height_m"))
    base = Floor(BASE_FLOOR, (given["base_name"] or gettext("Ground floor")).strip(), given["base_level"])
    with _limit.slot():
        new = NewFloor(floor, base, _received(given.get("file")))
        edit = floors.add_floor(library(), record.id, new=new, account_id=account().id, settings=settings())
    return state.edited(record, edit.revision)


@blueprint.patch(f"/{_ID}")
@map_role("editor")
@blueprint.input(FloorIn, arg_name="data")
@blueprint.output(EditAnswer)
def change(slug: str, id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Change name, level or height of a floor, as one step that can be undone."""
    record = open_map(slug, "editor")
    fields = {**data, **({"name": data["name"].strip()} if "name" in data else {})}
    edit = floors.change_floor(library(), record.id, id=id, fields=fields, account_id=account().id)
    return state.edited(record, edit.revision)


@blueprint.put(f"/{_ID}/image")
@map_role("editor")
@blueprint.input(FloorImageIn, location="files", arg_name="given")
@blueprint.output(EditAnswer)
def put_image(slug: str, id: int, given: dict[str, FileStorage]) -> dict[str, Any]:
    """Replace the image of a floor, as one step that can be undone; photos stay where they are."""
    record = open_map(slug, "editor")
    with _limit.slot():
        file = _received(given["file"])
        if file is None:
            raise UsageError("the image is missing", where="file")
        edit = floors.set_floor_image(
            library(), record.id, id=id, file=file, account_id=account().id, settings=settings()
        )
    return state.edited(record, edit.revision)


@blueprint.post(f"/{_ID}/align")
@map_role("editor")
@blueprint.input(AlignIn, arg_name="data")
@blueprint.output(EditAnswer)
def align(slug: str, id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Move, turn and scale the image of a floor, with its photos and notes, as one step that can be undone.

    One pair of spots moves it, two also turn and scale it, from three on it may be sheared.
    """
    record = open_map(slug, "editor")
    pairs = [(MapPixel(*pair["shown"]), MapPixel(*pair["wanted"])) for pair in data["pairs"]]
    edit = align_floor(library(), record.id, id=id, pairs=pairs, account_id=account().id)
    return state.edited(record, edit.revision)


@blueprint.delete(f"/{_ID}")
@blueprint.input(RemoveQuery, location="query", arg_name="query")
@blueprint.output(EditAnswer)
def remove(slug: str, id: int, query: dict[str, bool]) -> dict[str, Any]:
    """Remove a floor, as one step that can be undone."""
    record = open_map(slug, "editor")
    edit = floors.remove_floor(library(), record.id, id=id, to_tray=query["tray"], account_id=account().id)
    return state.edited(record, edit.revision)


@blueprint.get(f"/{_ID}/image")
@blueprint.doc(responses=file_answer("A picture that covers the map.", "image/webp"))
def image(slug: str, id: int) -> Response:
    """Get the image of a floor, warped into the map's frame."""
    record = open_map(slug, binned=True)
    shown = display.floor_picture(
        library(), record, floor=floors.found_floor(record, id), settings=settings()
    )
    return send_immutable(shown.path, etag=shown.key)


def _received(file: FileStorage | None) -> Path | None:
    if file is None:
        return None
    part = library().uploads / f"{secrets.token_hex(16)}.image"
    with show_file_as(tidy_name(file.filename or ""), part):
        receive(part, file.stream, max_bytes=int(settings().satellite.max_mb * 1e6))
    return part
