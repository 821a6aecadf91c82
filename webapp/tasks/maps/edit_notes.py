"""Edits notes at spots of a library map; each change is one edit that can be undone."""

from __future__ import annotations

from dataclasses import replace

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import inside
from webapp.core.mapmodel.notes import MOST_NOTES, NOTE_TEXT, MapNote, title_problem
from webapp.errors import NotFound, UsageError
from webapp.files.maps.lists import note_fields
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import floors, notes


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
        UsageError
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
