"""The lists of a map in `map.json`, and in the columns of the same names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.notes import NOTE_TEXT, MapNote, title_problem
from webapp.files.json_fields import JsonField, by_id
from webapp.files.maps.control_points import control_point_fields, parse_control_points
from webapp.files.maps.facts import parse_text
from webapp.files.maps.floors import floors_fields, parse_floors


def parse_notes(field: JsonField) -> tuple[MapNote, ...]:
    """Read a list of notes, sorted by id."""
    found = by_id(field, parse=_note)
    return tuple(found[id] for id in sorted(found))


def note_fields(note: MapNote) -> dict[str, Any]:
    """Return the fields of a note in `map.json`, without its id and empty values."""
    at = note.position
    return {
        "title": note.title,
        **({} if at is None else {"x_px": at.x, "y_px": at.y}),
        **({"text": note.text} if note.text else {}),
        **({"photos": list(note.photos)} if note.photos else {}),
        **({"floor": note.floor} if note.floor != BASE_FLOOR else {}),
    }


def notes_fields(notes: Iterable[MapNote]) -> list[dict[str, Any]]:
    """Return the list of notes for `map.json`."""
    return [{"id": note.id, **note_fields(note)} for note in notes]


def _note(item: JsonField) -> tuple[int, MapNote]:
    fields = item.record(required=("id", "title"), optional=("x_px", "y_px", "text", "photos", "floor"))
    problem = title_problem(fields["title"].text())
    if problem:
        raise fields["title"].error(problem)
    x, y = (fields[axis] for axis in ("x_px", "y_px"))
    if x.missing != y.missing:
        raise item.error("has only one of x_px and y_px", hint="give both or none")
    number = fields["id"].integer(largest=MAX_NUMBER)
    position = None if x.missing else MapPixel(x.pixels(), y.pixels())
    photos = [photo.integer(largest=MAX_NUMBER) for photo in fields["photos"].items()]
    text = parse_text(fields["text"], NOTE_TEXT) or ""
    floor = fields["floor"].integer(default=BASE_FLOOR, largest=MAX_NUMBER)
    return number, MapNote(
        number, fields["title"].text(), position, text, tuple(dict.fromkeys(photos)), floor
    )


class ListForm(NamedTuple):
    """How a list is read strictly, and written."""

    parse: Callable[[JsonField], tuple[Any, ...]]
    fields: Callable[[Any], list[dict[str, Any]]]


LISTS: Mapping[str, ListForm] = {
    "control_points": ListForm(parse_control_points, control_point_fields),
    "notes": ListForm(parse_notes, notes_fields),
    "floors": ListForm(parse_floors, floors_fields),
}
"""By the names of the fields of `MapLists`, in the order of files."""
