"""API of maps and the positions of their photos: list, state, edits, undo and redo."""

from __future__ import annotations

from typing import Any, Literal

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested, String
from apiflask.validators import OneOf

from webapp.core.mapmodel.model import EDITED
from webapp.errors import Conflict
from webapp.store.list_parts import ListPart
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps import delete_map, edit_map
from webapp.tasks.maps.edit_map import KINDS, RequestedEdit
from webapp.web.context import account, if_match, library, map_role, open_map, reading_map
from webapp.web.fields import LATER, Boolean, BoundedList, ListPartQuery, RecordNumber, split, wanted_part
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer, MapChanges, MapState, PhotoChange
from webapp.web.openapi import json_answer

blueprint = APIBlueprint("maps", __name__, url_prefix="/api/v1/maps", tag="Maps")

_MOST = 10_000
"""Maximum number of photos in one edit."""

_KIND_OF = {"x_px": "move", **{name: fact.kind for name, fact in EDITED.items()}, "floor": "floor"}

_EDITED = json_answer("What the edit changed.", EditAnswer)


class NewMap(Schema):
    """Name of a new map, or new name of a map."""

    name = String(required=True, validate=LATER, metadata={"example": "Stromovka park"})


class DeleteQuery(Schema):
    """Option of deleting a map."""

    forever = Boolean(load_default=False, metadata={"description": "For good; only maps in the bin."})


class MapSummary(Schema):
    """A map in a list."""

    slug = String()
    name = String()
    role = String(metadata={"enum": list(maps.ROLES)})
    photos = Integer()
    placed = Integer()
    changed_at = String()
    binned = Boolean()
    revision = Integer()


class MapList(Schema):
    """Maps, the last changed first."""

    maps = List(Nested(MapSummary))
    next = String(allow_none=True, metadata={"description": "`after` for those that follow; null: none do."})


class NumberedChange(PhotoChange):
    """A change with the id of its photo."""

    id = RecordNumber(required=True)


class EditRequest(Schema):
    """Changes of several photos in one step."""

    seen = RecordNumber(metadata={"description": "Newest revision you know; later changes are a conflict."})
    kind = String(load_default="move", validate=OneOf(KINDS))
    placement = String(allow_none=True, load_default=None, validate=LATER)
    changes = BoundedList(Nested(NumberedChange), required=True, least=1, most=_MOST)


class RemoveRequest(Schema):
    """Photos to remove from the map."""

    seen = RecordNumber()
    ids = BoundedList(RecordNumber(), required=True, least=1, most=_MOST)


class Since(Schema):
    """The revision to start from."""

    since = RecordNumber(least=-1, load_default=-1)


@blueprint.get("")
@blueprint.input(ListPartQuery, location="query", arg_name="query")
@blueprint.output(MapList)
def list_maps(query: dict[str, Any]) -> dict[str, Any]:
    """List the maps that the caller may see; with a `limit`, in pages."""
    who = account()
    with library().database.read() as session:
        found = maps.list_maps(session, who, part=ListPart(**wanted_part(query)))
        shown, last = split(found, query["limit"])
        return {
            "maps": state.summaries(session, shown, account=who),
            "next": None if last is None else maps.cursor(last).text(),
        }


@blueprint.post("")
@blueprint.input(NewMap, arg_name="data")
@blueprint.output(MapSummary, status_code=201)
def create(data: dict[str, str]) -> dict[str, Any]:
    """Create an empty map."""
    who, place = account(), library()
    delete_map.delete_orphans(place)  # otherwise the new map could not reuse the name of a deleted one
    folders = [path.name for path in place.folder.iterdir()]
    with place.database.write() as session:
        record = maps.create(session, data["name"], account_id=who.id, folders=folders)
        return state.summary(session, record, account=who)


@blueprint.get("/<slug>")
@blueprint.doc(responses=json_answer("The whole state of a map.", MapState))
def show(slug: str) -> dict[str, Any]:
    """Get the whole state of a map."""
    with reading_map(slug, binned=True) as (session, record):
        return state.whole(session, record, account=account())


@blueprint.patch("/<slug>")
@map_role("owner")
@blueprint.input(NewMap, arg_name="data")
@blueprint.output(MapSummary)
def rename(slug: str, data: dict[str, str]) -> dict[str, Any]:
    """Rename a map; its URL stays the same."""
    record, who = open_map(slug, "owner"), account()
    with library().database.write() as session:
        row = session.get_one(MapRecord, record.id)
        maps.rename(row, data["name"])
        return state.summary(session, row, account=who)


@blueprint.delete("/<slug>")
@blueprint.input(DeleteQuery, location="query", arg_name="query")
@blueprint.output(MapSummary)
def put_into_bin(slug: str, query: dict[str, Any]) -> dict[str, Any]:
    """Move a map to the bin, from which it can be restored; or delete one in the bin permanently."""
    if not query["forever"]:
        return _binned(slug, into=True)
    record, who = open_map(slug, "owner", binned=True), account()
    with library().database.read() as session:
        last = state.summary(session, session.get_one(MapRecord, record.id), account=who)
    delete_map.delete_map(library(), record.id)
    return last


@blueprint.post("/<slug>/restore")
@blueprint.output(MapSummary)
def restore(slug: str) -> dict[str, Any]:
    """Restore a map from the bin."""
    return _binned(slug, into=False)


@blueprint.get("/<slug>/changes")
@blueprint.input(Since, location="query", arg_name="query")
@blueprint.doc(responses=json_answer("What changed, and the jobs of the map.", MapChanges))
def changes(slug: str, query: dict[str, int]) -> dict[str, Any]:
    """Get the changes since a revision."""
    with reading_map(slug) as (session, record):
        return state.changes(session, record, account=account(), since=query["since"])


@blueprint.patch("/<slug>/experiences")
@map_role("editor")
@blueprint.input(EditRequest, arg_name="data")
@blueprint.doc(responses=_EDITED)
def edit_many(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Change photos (place, move, turn, ...); either all changes are made or none."""
    wanted: dict[int, dict[str, Any]] = {}
    for change in data["changes"]:
        wanted.setdefault(change.pop("id"), {}).update(change)
    edit = RequestedEdit(data["kind"], wanted, placement=data["placement"], seen=data.get("seen"))
    return _edited(slug, edit)


@blueprint.delete("/<slug>/experiences")
@map_role("editor")
@blueprint.input(RemoveRequest, arg_name="data")
@blueprint.doc(responses=_EDITED)
def remove_many(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Remove photos from the map, as one step that can be undone."""
    gone = {id: {"removed": True} for id in data["ids"]}
    return _edited(slug, RequestedEdit("remove", gone, seen=data.get("seen")))


@blueprint.patch("/<slug>/experiences/<id:id>")
@map_role("editor")
@blueprint.input(PhotoChange, arg_name="data")
@blueprint.doc(responses=_EDITED)
def edit_one(slug: str, id: int, data: dict[str, Any]) -> dict[str, Any]:
    """Change one photo (place, move, turn, ...); `If-Match` is the revision that the caller knows."""
    kinds = [kind for field, kind in _KIND_OF.items() if field in data]
    kind = next((kind for kind in kinds if kind != "turn"), "turn")  # often given along with another change
    return _edited(slug, RequestedEdit(kind, {id: data}, seen=if_match()))


@blueprint.delete("/<slug>/experiences/<id:id>")
@blueprint.doc(responses=_EDITED)
def remove_one(slug: str, id: int) -> dict[str, Any]:
    """Remove a photo from the map, as one step that can be undone."""
    return _edited(slug, RequestedEdit("remove", {id: {"removed": True}}, seen=if_match()))


@blueprint.post("/<slug>/undo")
@blueprint.doc(responses=_EDITED)
def undo(slug: str) -> dict[str, Any]:
    """Undo the caller's last edit of the map."""
    return _undone_or_redone(slug, "undo")


@blueprint.post("/<slug>/redo")
@blueprint.doc(responses=_EDITED)
def redo(slug: str) -> dict[str, Any]:
    """Redo the caller's last undone edit of the map."""
    return _undone_or_redone(slug, "redo")


def _binned(slug: str, *, into: bool) -> dict[str, Any]:
    record, who = open_map(slug, "owner", binned=True), account()
    with library().database.write() as session:
        row = session.get_one(MapRecord, record.id)
        (maps.put_into_bin if into else maps.take_from_bin)(row)
        return state.summary(session, row, account=who)


def _edited(slug: str, edit: RequestedEdit) -> dict[str, Any]:
    record = open_map(slug, "editor")
    return state.edited(record, edit_map.edit_map(library(), record.id, edit=edit, account_id=account().id))


def _undone_or_redone(slug: str, way: Literal["undo", "redo"]) -> dict[str, Any]:
    record = open_map(slug, "editor")
    step = edit_map.undo_or_redo(library(), record.id, way=way, account_id=account().id)
    if step is None:
        raise Conflict(f"there is nothing to {way}", hint="only your own edits of this map can be undone")
    if step.clash is not None:
        hint = f"your edit stays out of {way} from now on; the one before it can be taken back"
        raise Conflict(step.clash, where=f"map {slug}", hint=hint)
    return state.edited(record, step.edit.revision)
