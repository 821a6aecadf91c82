"""API of notes on spots of a map; notes on photos are edits of the photos."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, List, Nested, String
from apiflask.validators import Length

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.notes import MOST_TITLE, NOTE_TEXT, MapNote
from webapp.tasks.maps import edit_map
from webapp.web.context import account, if_match, library, map_role, open_map
from webapp.web.fields import BoundedList, RecordNumber
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer, NoteOut

blueprint = APIBlueprint("api_notes", __name__, url_prefix="/api/v1/maps/<slug>/notes", tag="Maps")

_ID = "<id:id>"
_MOST_PHOTOS = 500


class NoteIn(Schema):
    """Content and position of a note."""

    title = String(required=True, validate=Length(1, MOST_TITLE))
    text = String(load_default="", validate=Length(max=NOTE_TEXT.most))
    x_px = Float(required=True)
    y_px = Float(required=True)
    photos = BoundedList(
        RecordNumber(),
        load_default=list,
        most=_MOST_PHOTOS,
        metadata={"description": "Ids of the photos that it is about."},
    )
    floor = RecordNumber(
        load_default=None,
        metadata={"description": "Id of its floor; without one, a new note is on 0, others stay on theirs."},
    )


class NotesOut(Schema):
    """The notes on spots of a map."""

    notes = List(Nested(NoteOut))


@blueprint.get("")
@blueprint.output(NotesOut)
def show(slug: str) -> dict[str, Any]:
    """List the notes on spots of the map."""
    return {"notes": state.notes_json(open_map(slug))}


@blueprint.post("")
@map_role("editor")
@blueprint.input(NoteIn, arg_name="data")
@blueprint.output(EditAnswer, status_code=201)
def add(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Add a note, as one step that can be undone."""
    record = open_map(slug, "editor")
    note = _note(0, data)
    return state.edited(record, edit_map.add_note(library(), record.id, note=note, account_id=account().id))


@blueprint.put(f"/{_ID}")
@map_role("editor")
@blueprint.input(NoteIn, arg_name="data")
@blueprint.output(EditAnswer)
def change(slug: str, id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Replace a note, as one step that can be undone; `If-Match` is the revision that the caller knows."""
    record = open_map(slug, "editor")
    revision = edit_map.change_note(
        library(),
        record.id,
        note=_note(id, data),
        account_id=account().id,
        seen=if_match(),
        keep_floor=data["floor"] is None,
    )
    return state.edited(record, revision)


@blueprint.delete(f"/{_ID}")
@blueprint.output(EditAnswer)
def remove(slug: str, id: int) -> dict[str, Any]:
    """Remove a note, as one step that can be undone; `If-Match` is the revision that the caller knows."""
    record = open_map(slug, "editor")
    revision = edit_map.remove_note(library(), record.id, id=id, account_id=account().id, seen=if_match())
    return state.edited(record, revision)


def _note(id: int, data: dict[str, Any]) -> MapNote:
    text, photos = data["text"].strip(), tuple(dict.fromkeys(data["photos"]))
    floor = BASE_FLOOR if data["floor"] is None else data["floor"]
    return MapNote(id, data["title"].strip(), MapPixel(data["x_px"], data["y_px"]), text, photos, floor)
