"""The lists of a map (control points, floors, notes) in `map.json`, and in the columns of the same names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from webapp.core.geo.affine import Affine, is_affine
from webapp.core.geo.floors import (
    BASE_FLOOR,
    Floor,
    FloorImage,
    floor_name_problem,
    floors_problem,
    level_problem,
)
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick, Tag, facts_problem
from webapp.core.mapmodel.control_points import name_problem as point_name_problem
from webapp.core.mapmodel.notes import NOTE_TEXT, MapNote, title_problem
from webapp.core.mapmodel.paths import name_problem
from webapp.files.json_fields import JsonField, by_id, finite
from webapp.files.maps.facts import parse_text

_FACTS = ("x_px", "y_px", "accuracy_m", "height_m", "photos", "tag", "check")


def parse_control_points(field: JsonField) -> tuple[GroundControlPoint, ...]:
    """Read a list of control points, sorted by name."""
    found: dict[str, GroundControlPoint] = {}
    for item in field.items():
        fields = item.record(required=("name",), optional=_FACTS)
        name = fields["name"].text()
        problem = point_name_problem(name)
        if problem:
            raise fields["name"].error(problem)
        if name in found:
            raise item.error(f"repeats the control point {name!r}")
        point = _point(name, fields, item)
        problem = facts_problem(point)
        if problem:
            raise item.error(problem)
        found[name] = point
    return tuple(found[name] for name in sorted(found))


def point_fields(point: GroundControlPoint) -> dict[str, Any]:
    """Return the fields of a control point in `map.json`, without its name and unknown values."""
    at = point.position
    known = {
        "x_px": None if at is None else at.x,
        "y_px": None if at is None else at.y,
        "accuracy_m": point.accuracy_m,
        "height_m": point.height_m,
    }
    clicks = [{"id": click.photo, "x": click.x, "y": click.y} for click in point.clicks]
    tag = {} if point.tag is None else {"tag": tag_fields(point.tag)}
    check = {"check": True} if point.is_check else {}
    return {
        **{name: value for name, value in known.items() if value is not None},
        "photos": clicks,
        **tag,
        **check,
    }


def tag_fields(tag: Tag) -> dict[str, Any]:
    """Return the fields of a tag in `map.json` and in the API, without an unknown heading."""
    known = {"family": tag.family, "id": tag.number, "size_mm": tag.size_mm, "mount": tag.mount}
    return {**known, **({} if tag.heading_deg is None else {"heading_deg": tag.heading_deg})}


def control_point_fields(points: Iterable[GroundControlPoint]) -> list[dict[str, Any]]:
    """Return the list of control points for `map.json`."""
    return [{"name": point.name, **point_fields(point)} for point in points]


def _point(name: str, fields: Mapping[str, JsonField], item: JsonField) -> GroundControlPoint:
    x, y, accuracy, height = (fields[field] for field in _FACTS[:4])
    if x.missing != y.missing:
        raise item.error("has only one of x_px and y_px", hint="give both or none")
    clicks: dict[int, PhotoClick] = {}
    for click in fields["photos"].items():
        part = click.record(required=("id", "x", "y"))
        id = part["id"].integer(largest=MAX_NUMBER)
        if id in clicks:
            raise click.error(f"repeats the photo {id}")
        clicks[id] = PhotoClick(id, _share(part["x"]), _share(part["y"]))
    return GroundControlPoint(
        name,
        None if x.missing else MapPixel(x.pixels(), y.pixels()),
        tuple(clicks[id] for id in sorted(clicks)),
        None if accuracy.missing else accuracy.number("a finite number of metres", valid=finite),
        None if height.missing else height.number("a finite number of metres", valid=finite),
        None if fields["tag"].missing else _tag(fields["tag"]),
        not fields["check"].missing and fields["check"].boolean(),
    )


def _tag(item: JsonField) -> Tag:
    fields = item.record(required=("family", "id", "size_mm"), optional=("mount", "heading_deg"))
    mount, heading = fields["mount"], fields["heading_deg"]
    return Tag(
        fields["family"].text(),
        fields["id"].integer(largest=MAX_NUMBER),
        fields["size_mm"].number("a finite number of millimetres", valid=finite),
        "wall" if mount.missing else mount.text(),  # type: ignore[arg-type]  # `facts_problem` checks it
        None if heading.missing else heading.number("a finite number of degrees", valid=finite),
    )


def _share(field: JsonField) -> float:
    return field.number("from 0 to 1", valid=lambda v: 0.0 <= v <= 1.0)


def parse_floors(field: JsonField) -> tuple[Floor, ...]:
    """Read a list of floors, sorted by id."""
    found = by_id(field, parse=_floor)
    floors = tuple(found[id] for id in sorted(found))
    problem = floors_problem(floors)
    if problem:
        raise field.error(problem)
    return floors


def check_floors_of(
    field: JsonField, floor_of: Mapping[int, int], *, what: str, floors: Iterable[Floor]
) -> None:
    """Refuse photos or notes (by id) on floors that the map does not have."""
    known = {BASE_FLOOR, *(floor.id for floor in floors)}
    for id, floor in floor_of.items():
        if floor not in known:
            raise field.error(f"has the {what} {id} on the floor {floor}, which is not in $.floors")


def floor_fields(floor: Floor) -> dict[str, Any]:
    """Return the fields of a floor in `map.json`, without its id and unknown values."""
    image = floor.image
    return {
        "name": floor.name,
        "level": floor.level,
        **({} if floor.height_m is None else {"height_m": floor.height_m}),
        **({} if image is None else {"image": _image_fields(image)}),
    }


def floors_fields(floors: Iterable[Floor]) -> list[dict[str, Any]]:
    """Return the list of floors for `map.json`."""
    return [{"id": floor.id, **floor_fields(floor)} for floor in floors]


def _image_fields(image: FloorImage) -> dict[str, Any]:
    m = image.map_from_image
    return {
        "path": image.path,
        "width": image.width,
        "height": image.height,
        "map_from_image": [list(m[0:3]), list(m[3:6])],
    }


def _floor(item: JsonField) -> tuple[int, Floor]:
    fields = item.record(required=("id", "name", "level"), optional=("height_m", "image"))
    number = fields["id"].integer(largest=MAX_NUMBER)
    problem = floor_name_problem(fields["name"].text())
    if problem:
        raise fields["name"].error(problem)
    level = fields["level"].number("a finite number", valid=finite)
    if level_problem(level):
        raise fields["level"].error(str(level_problem(level)))
    height, image = fields["height_m"], fields["image"]
    if number == BASE_FLOOR and not image.missing:
        raise image.error("belongs to a further floor: the map's own image shows this one")
    height_m = None if height.missing else height.number("a finite number of metres", valid=finite)
    return number, Floor(
        number, fields["name"].text(), level, height_m, None if image.missing else _image(image)
    )


def _image(item: JsonField) -> FloorImage:
    fields = item.record(required=("path", "width", "height", "map_from_image"))
    problem = name_problem(fields["path"].text())
    if problem:
        raise fields["path"].error(problem.message)
    width, height = (fields[side].integer(smallest=1, largest=MAX_NUMBER) for side in ("width", "height"))
    return FloorImage(fields["path"].text(), width, height, _affine(fields["map_from_image"]))


def _affine(field: JsonField) -> Affine:
    rows = [row.items() for row in field.items()]
    if [len(row) for row in rows] != [3, 3]:
        raise field.error("must be two rows of three numbers")
    a, b, c, d, e, f = (cell.number("a finite number", valid=finite) for row in rows for cell in row)
    if not is_affine((a, b, c, d, e, f)):
        raise field.error("has no inverse")
    return (a, b, c, d, e, f)


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
