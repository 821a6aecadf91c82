"""Floors in `map.json`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from webapp.core.geo.affine import Affine, is_affine
from webapp.core.geo.floors import (
    BASE_FLOOR,
    Floor,
    FloorImage,
    floor_name_problem,
    floors_problem,
    level_problem,
)
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.paths import name_problem
from webapp.files.json_fields import JsonField, by_id, finite


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
    """Refuse photos or notes (by id) on floors that the map does not have.

    Args:
        what: `photo` or `note`.
    """
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
