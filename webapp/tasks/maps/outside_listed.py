"""Compares control points, notes and floors of an edited map file with the records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.mapmodel.model import Map
from webapp.files.maps.control_points import point_fields
from webapp.files.maps.floors import floor_fields
from webapp.files.maps.notes import note_fields
from webapp.store.maps import edits
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import control_points, floors, notes

Fields = dict[str, Any]


def changed_points(
    session: Session, record: MapRecord, map_: Map, *, known: Mapping[int, int]
) -> dict[str, Fields]:
    """Return the control points that change, by target of an edit; those missing in the file are kept.

    Args:
        known: Id in the records for each photo id that may occur in the file, including removed photos.
    """
    after = {}
    for point in map_.control_points:
        clicks = [c._replace(photo=known[c.photo]) for c in point.clicks if c.photo in known]
        after[f"point/{point.name}"] = point_fields(replace(point, clicks=tuple(sorted(clicks))))
    before = {f"point/{point.name}": point_fields(point) for point in control_points(record)}
    return _changed(session, record, before=before, after=after)


def changed_notes(
    session: Session, record: MapRecord, map_: Map, *, known: Mapping[int, int]
) -> dict[str, Fields]:
    """Return the notes at spots that change; see `changed_points`.

    If the file has no floors, existing notes stay on theirs.
    """
    there = {note.id: note for note in notes(record)}
    after = {}
    for note in map_.notes:
        photos = tuple(known[id] for id in note.photos if id in known)
        floor = there[note.id].floor if not map_.floors and note.id in there else note.floor
        after[f"note/{note.id}"] = note_fields(replace(note, photos=photos, floor=floor))
    before = {f"note/{id}": note_fields(note) for id, note in there.items()}
    return _changed(session, record, before=before, after=after)


def changed_floors(session: Session, record: MapRecord, map_: Map) -> dict[str, Fields]:
    """Return the floors that change; see `changed_points`."""
    after = {f"floor/{floor.id}": floor_fields(floor) for floor in map_.floors}
    before = {f"floor/{floor.id}": floor_fields(floor) for floor in floors(record)}
    return _changed(session, record, before=before, after=after)


def _changed(
    session: Session, record: MapRecord, *, before: Mapping[str, Fields], after: Mapping[str, Fields]
) -> dict[str, Fields]:
    """Leave out equal ones, and those changed in the library since the file was written."""
    return {
        target: fields
        for target, fields in after.items()
        if fields != before.get(target)
        and edits.revision_of_listed(session, record, target) <= record.exported_revision
    }
