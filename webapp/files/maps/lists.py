"""The lists of a map in `map.json`, and in the columns of the same names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from webapp.files.json_fields import JsonField
from webapp.files.maps.control_points import control_point_fields, parse_control_points
from webapp.files.maps.floors import floors_fields, parse_floors
from webapp.files.maps.notes import notes_fields, parse_notes


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
