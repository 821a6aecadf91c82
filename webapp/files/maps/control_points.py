"""Control points in `map.json`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick, facts_problem, name_problem
from webapp.files.json_fields import JsonField, finite

_FACTS = ("x_px", "y_px", "accuracy_m", "height_m", "photos")


def parse_control_points(field: JsonField) -> tuple[GroundControlPoint, ...]:
    """Read a list of control points, sorted by name."""
    found: dict[str, GroundControlPoint] = {}
    for item in field.items():
        fields = item.record(required=("name",), optional=_FACTS)
        name = fields["name"].text()
        problem = name_problem(name)
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
    return {**{name: value for name, value in known.items() if value is not None}, "photos": clicks}


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
    )


def _share(field: JsonField) -> float:
    return field.number("from 0 to 1", valid=lambda v: 0.0 <= v <= 1.0)
