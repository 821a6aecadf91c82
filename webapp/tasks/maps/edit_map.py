"""Validates edits made on the page of a map, and applies each as one step that can be undone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel, inside
from webapp.core.mapmodel.clusters import gather
from webapp.core.mapmodel.facts import FixedForm, NumberForm, TextForm
from webapp.core.mapmodel.model import EDITED, FACTS
from webapp.core.mapmodel.notes import MOST_NOTES, NOTE_TEXT, MapNote, title_problem
from webapp.errors import NotFound, UsageError
from webapp.files.maps.facts import panorama_fields, parse_panorama
from webapp.files.maps.lists import note_fields
from webapp.files.maps.map_json import check_placement_name
from webapp.files.photos.panorama import is_whole_sphere
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.maps.changing import MapChange
from webapp.store.maps.edits import UndoResult
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere
from webapp.tasks.maps.library_map import floors, notes

KINDS = tuple(
    dict.fromkeys(
        ("place", "move", "turn", "unplace", *(fact.kind for fact in EDITED.values()), "floor", "remove")
    )
)
"""Kinds of edits."""


@dataclass(frozen=True, slots=True)
class RequestedEdit:
    kind: str  # One of `KINDS`
    # New values of `x_px`, `y_px`, `floor`, `removed` or a fact of `EDITED` by photo. x and y must be given
    # together; None for both moves the photo back to the tray.
    changes: Mapping[int, Mapping[str, Any]]
    placement: str | None = None  # Placement whose positions change; None for the main one
    seen: int | None = None  # Newest revision known to the author


def edit_map(library: Library, map_id: int, *, edit: RequestedEdit, account_id: int) -> int | None:
    """Make an edit.

    Returns:
        Revision of the edit; None if nothing changed.

    Raises:
        UsageError: A position is outside the image, or a value is not valid.
        Conflict: One of the photos was changed after `seen`.
    """
    if edit.kind not in KINDS:
        raise UsageError(f"{edit.kind!r} is not a kind of edit", where="kind", hint=f"use {', '.join(KINDS)}")
    empty = next((id for id, fields in edit.changes.items() if not fields), None)
    if empty is not None:
        raise UsageError(
            "the change has no field",
            where=f"photo/{empty}",
            hint="give new values; to remove photos from the map, use DELETE",
        )
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        if edit.placement is not None:
            refuse_taken_name(session, record, edit.placement)
        there = maps.present_photos(session, record, edit.changes)  # held: session refs are weak
        changes: dict[str, Mapping[str, Any] | None] = {}
        for id in there:
            fields = _with_panorama(there[id], edit.changes[id])
            fields = _with_floor(record, there[id], fields, placement=edit.placement)
            changes |= _targets(record, id, fields=fields, placement=edit.placement)
        done = edits.apply(
            session, record, changes=changes, kind=edit.kind, account_id=account_id, seen=edit.seen
        )
    return None if done is None else done.revision


def undo_or_redo(
    library: Library, map_id: int, *, way: Literal["undo", "redo"], account_id: int
) -> UndoResult | None:
    """Undo or redo the account's last edit; None when there is none."""
    step_back_or_on = edits.undo if way == "undo" else edits.redo
    with library.changing(map_id) as change:
        return step_back_or_on(change.session, change.record, account_id=account_id)


def _targets(
    record: MapRecord, id: int, *, fields: Mapping[str, Any], placement: str | None
) -> dict[str, Mapping[str, Any] | None]:
    known = dict(fields)
    if ("x_px" in known) != ("y_px" in known):
        raise UsageError("x_px and y_px go together", where=f"photo/{id}", hint="give both")
    for name in EDITED:
        if known.get(name) is not None:
            known[name] = _tidy(name, known[name], id)
    if "x_px" not in known:
        return {f"photo/{id}": known} if known else {}
    at = {axis: known.pop(axis) for axis in ("x_px", "y_px")}
    if (at["x_px"] is None) != (at["y_px"] is None):
        raise UsageError("one of x_px and y_px is missing", where=f"photo/{id}", hint="give both or neither")
    _check_inside(record, at, id=id)
    if placement is None:
        return {f"photo/{id}": {**at, **known}}
    target = f"placed/{placement}/{id}"
    return {target: None if at["x_px"] is None else at, **({f"photo/{id}": known} if known else {})}


def _with_panorama(photo: Photo, fields: Mapping[str, Any]) -> Mapping[str, Any]:
    """Validate a change of `panorama`, and set the matching field of view; 360 degrees for a panorama.

    A change without pitch and roll, such as that of a mask, keeps them.
    """
    if "panorama" not in fields:
        return fields
    new, tilt = fields["panorama"], {k: v for k, v in (photo.panorama or {}).items() if k != "masked"}
    panorama = parse_panorama(None if new is None else {**tilt, **new}, where=f"photo/{photo.id}")
    if panorama is None:
        return {**fields, "fov_deg": None if photo.panorama is not None else photo.fov_deg}
    if not is_whole_sphere(photo.width, photo.height):
        raise UsageError(
            f"{photo.name} is not a full panorama, twice as wide as high", where=f"photo/{photo.id}"
        )
    return {**fields, "panorama": panorama_fields(panorama), "fov_deg": 360.0}


def _with_floor(
    record: MapRecord, photo: Photo, fields: Mapping[str, Any], *, placement: str | None
) -> Mapping[str, Any]:
    """Validate the floor; reset it for a photo moved to the tray, but not for one that leaves a placement."""
    if placement is None and fields.get("x_px", ...) is None and photo.floor != BASE_FLOOR:
        return {**fields, "floor": BASE_FLOOR}
    known = {BASE_FLOOR, *(floor["id"] for floor in record.floors or ())}
    if "floor" in fields and fields["floor"] not in known:
        raise UsageError(
            f"the map has no floor {fields['floor']}", where=f"photo/{photo.id}", hint="reload the page"
        )
    return fields


def _tidy(name: str, value: Any, id: int) -> Any:
    """Check the new value of a fact, and return it as it is stored."""
    match FACTS[name].form:
        case FixedForm.HEADING:
            return _heading(value, id)
        case FixedForm.TIME:
            return _time(value, id)
        case NumberForm(valid_ones, is_valid):
            if not (math.isfinite(value) and is_valid(value)):
                raise UsageError(f"{name} is not {valid_ones}", where=f"photo/{id}")
            return float(value)
        case TextForm() as form:
            tidy = value.strip()
            problem = form.problem(tidy)
            if problem:
                raise UsageError(f"the {name} {problem}", where=f"photo/{id}")
            return tidy or None
        case _:
            return value


def _heading(value: float, id: int) -> float:
    if not math.isfinite(value):
        raise UsageError(
            "the heading is not a number", where=f"photo/{id}", hint="degrees clockwise from north"
        )
    return float(value % 360.0 % 360.0)  # -1e-20 % 360 is 360


def _time(text: str, id: int) -> str:
    try:
        return datetime.fromisoformat(text).isoformat(timespec="seconds")
    except ValueError as error:
        raise UsageError(
            "taken_at is not a time", where=f"photo/{id}", hint="write it as 2026-05-31T14:05:00"
        ) from error


def _check_inside(record: MapRecord, at: Mapping[str, float | None], *, id: int) -> None:
    x, y = at["x_px"], at["y_px"]
    if x is None or y is None:
        return
    width, height = record.satellite_width, record.satellite_height
    if width is None or height is None:
        raise UsageError(
            "the map has no satellite image to place photos on", where=f"photo/{id}", hint="set one first"
        )
    if not (0 <= x <= width and 0 <= y <= height):  # also true for NaN
        raise UsageError(
            f"the position ({x:g}, {y:g}) is outside the image",
            where=f"photo/{id}",
            hint=f"x is from 0 to {width}, y from 0 to {height} pixels",
        )


def add_note(library: Library, map_id: int, *, note: MapNote, account_id: int) -> int | None:
    """Add a note with a new id.

    Returns:
        Revision of the edit.

    Raises:
        UsageError: The note is not valid, or the map has too many.
        NotFound: A photo of the note does not exist.
    """
    with library.changing(map_id) as change:
        there = notes(change.record)
        if len(there) >= MOST_NOTES:
            raise UsageError(f"the map has {MOST_NOTES} notes already", hint="remove some first")
        numbered = replace(note, id=1 + max((one.id for one in there), default=0))
        return _write(change, numbered, account_id=account_id)


def change_note(
    library: Library,
    map_id: int,
    *,
    note: MapNote,
    account_id: int,
    seen: int | None = None,
    keep_floor: bool = False,
) -> int | None:
    """Replace a note; return the revision of the edit, or None if nothing changed.

    Args:
        keep_floor: Ignore the floor of `note`, and keep the current one.
        seen: Newest revision known to the author; None overwrites without a check.

    Raises:
        NotFound: The note, or one of its photos, does not exist.
        Conflict: The note was changed after `seen`.
    """
    with library.changing(map_id) as change:
        there = _found(change.record, note.id)
        changed = replace(note, floor=there.floor) if keep_floor else note
        return _write(change, changed, account_id=account_id, seen=seen)


def remove_note(
    library: Library, map_id: int, *, id: int, account_id: int, seen: int | None = None
) -> int | None:
    """Remove a note; for `seen` see `change_note`. Raises NotFound, Conflict."""
    with library.changing(map_id) as change:
        _found(change.record, id)
        done = edits.apply(
            change.session,
            change.record,
            changes={f"note/{id}": None},
            kind=edits.NOTES_KIND,
            account_id=account_id,
            seen=seen,
        )
    return None if done is None else done.revision


def _found(record: MapRecord, id: int) -> MapNote:
    found = next((note for note in notes(record) if note.id == id), None)
    if found is None:
        raise NotFound(f"the map has no note {id}", hint="somebody may have removed it; reload the page")
    return found


def _write(change: MapChange, note: MapNote, *, account_id: int, seen: int | None = None) -> int | None:
    session, record = change.session, change.record
    _check(record, note)
    maps.present_photos(session, record, note.photos)
    done = edits.apply(
        session,
        record,
        changes={f"note/{note.id}": note_fields(note)},
        kind=edits.NOTES_KIND,
        account_id=account_id,
        seen=seen,
    )
    return None if done is None else done.revision


def _check(record: MapRecord, note: MapNote) -> None:
    for what, problem in (("title", title_problem(note.title)), ("text", NOTE_TEXT.problem(note.text))):
        if problem:
            raise UsageError(f"the {what} of a note {problem}", where=what)
    width, height = record.satellite_width, record.satellite_height
    if width is None or height is None:
        raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
    if note.position is not None and not inside(note.position, width=width, height=height):
        raise UsageError("the note is outside the image", where="x_px, y_px")
    if note.floor not in {BASE_FLOOR, *(floor.id for floor in floors(record))}:
        raise UsageError(f"the map has no floor {note.floor}", where="floor", hint="reload the page")


KIND = "placement"
"""Kind of the edit."""


def put_placement(
    library: Library,
    map_id: int,
    *,
    name: str,
    account_id: int,
    positions: Mapping[int, MapPixel] | None = None,
    clusters_px: float | None = None,
) -> int | None:
    """Create or replace a placement; return the revision of the edit, None if nothing changed.

    Args:
        positions: Positions by photo id; by default those of the map.
        clusters_px: Instead of `positions`: move photos within this radius of each other to their common
            centre.

    Raises:
        UsageError: The name collides with another file, a position is outside the image, or no photo is
            placed.
        NotFound: A photo is not placed on the map.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        refuse_taken_name(session, record, name)
        there = {
            photo.id: MapPixel(photo.x_px, photo.y_px)
            for photo in maps.photos(session, record)
            if not photo.removed and photo.x_px is not None and photo.y_px is not None
        }
        wanted = there if positions is None else positions
        if clusters_px is not None:
            wanted = _gathered(session, record, there, radius_px=clusters_px)
        if not wanted:
            raise UsageError("no photo is placed on the map yet", hint="place photos first")
        _check_moves(record, wanted, there)
        changes: dict[str, Mapping[str, Any] | None] = {
            f"placed/{name}/{id}": None for id in _placed(session, record, name) if id not in wanted
        }
        changes |= {f"placed/{name}/{id}": {"x_px": at.x, "y_px": at.y} for id, at in wanted.items()}
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
    return None if edit is None else edit.revision


def _gathered(
    session: Session, record: MapRecord, there: Mapping[int, MapPixel], *, radius_px: float
) -> dict[int, MapPixel]:
    """Gather the photos of each floor separately."""
    floor_of = {photo.id: photo.floor for photo in maps.photos_by_id(session, record, there).values()}
    wanted: dict[int, MapPixel] = {}
    for floor in sorted(set(floor_of.values())):
        on_floor = {id: at for id, at in there.items() if floor_of[id] == floor}
        wanted |= gather(on_floor, radius_px=radius_px)
    return wanted


def delete_placement(library: Library, map_id: int, *, name: str, account_id: int) -> int | None:
    """Delete a placement, but not its photos or their positions on the map; return the edit's revision."""
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        ids = _placed(session, record, name)
        if not ids:
            raise NotFound(f"the map has no placement {name[:80]!r}", hint="reload the page")
        changes = {f"placed/{name}/{id}": None for id in ids}
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
    return None if edit is None else edit.revision


def refuse_taken_name(session: Session, record: MapRecord, name: str) -> None:
    """Refuse a name whose file would collide with that of the map or another placement, ignoring case.

    Raises:
        MapError: The name is not valid.
        UsageError: The name collides.
    """
    check_placement_name(name)
    others = session.scalars(
        select(PlacedElsewhere.placement).where(PlacedElsewhere.map_id == record.id).distinct()
    )
    taken = {"map"} | {other.casefold() for other in others if other != name}
    if name.casefold() in taken:
        raise UsageError(
            f"a placement cannot have the name {name!r}: its file would replace another one",
            where="name",
            hint="choose another name",
        )


def _check_moves(record: MapRecord, wanted: Mapping[int, MapPixel], there: Mapping[int, MapPixel]) -> None:
    width, height = record.satellite_width or 0, record.satellite_height or 0
    for id, at in wanted.items():
        if id not in there:
            raise NotFound(f"the photo {id} is not placed on the map", where=f"positions.{id}")
        if not (math.isfinite(at.x) and inside(at, width=width, height=height)):
            raise UsageError(
                f"the position ({at.x:g}, {at.y:g}) is outside the image",
                where=f"positions.{id}",
                hint=f"x is from 0 to {width}, y from 0 to {height} pixels",
            )


def _placed(session: Session, record: MapRecord, name: str) -> list[int]:
    found = select(PlacedElsewhere.photo_id).where(
        PlacedElsewhere.map_id == record.id, PlacedElsewhere.placement == name
    )
    return list(session.scalars(found))
