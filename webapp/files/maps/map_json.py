"""The data of a map that a `.cfg` cannot hold, in JSON next to it; `maps/FORMAT.md` has the schema."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import KW_ONLY, dataclass, field
from dataclasses import fields as dataclass_fields

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.facts import DESCRIPTION
from webapp.core.mapmodel.model import (
    FACTS,
    Experience,
    Map,
    MapLists,
    MapPhoto,
    Placement,
    UnplacedPhoto,
)
from webapp.errors import GeoreferenceError, MapError, MapJsonError
from webapp.files.json_fields import JsonField, by_id, finite, parse_json
from webapp.files.maps.facts import fact_fields, parse_facts
from webapp.files.maps.lists import LISTS, check_floors_of

FORMAT = "experience-map"
VERSION = 1


@dataclass(frozen=True, slots=True)
class MapJsonPhoto(MapPhoto):
    """The data of a placed photo in `map.json`; without a position, it has that of the `.cfg`."""

    _: KW_ONLY
    position: MapPixel | None = None
    by_gps: bool = False
    radius_px: float | None = None
    floor: int = BASE_FLOOR


@dataclass(frozen=True, slots=True)
class MapJson(MapLists):
    """The content of `map.json`; photos by id."""

    revision: int = 0
    next_id: int = 0
    georeference: Georeference | None = None
    placements: Mapping[str, Mapping[int, MapPixel]] = field(default_factory=dict)
    """Of each further placement by name, its sub-pixel positions by id."""
    experiences: Mapping[int, MapJsonPhoto] = field(default_factory=dict)
    title: str | None = None
    description: str | None = None
    unplaced: Mapping[int, UnplacedPhoto] = field(default_factory=dict)


def parse_map_json(data: bytes, *, where: str = "map.json") -> MapJson:
    """Parse `map.json` strictly: missing required fields and unknown fields are errors."""
    top = parse_json(data, where=where).record(
        required=("format", "version"),
        optional=tuple(part.name for part in dataclass_fields(MapJson)),
    )
    if top["format"].value != FORMAT:
        raise top["format"].error(f"must be {FORMAT!r}", hint="this is another program's file: rename it")
    if top["version"].integer(smallest=1, largest=MAX_NUMBER) != VERSION:
        raise top["version"].error(
            f"must be {VERSION}", hint="this map was written by a newer version: update"
        )
    placements: dict[str, Mapping[int, MapPixel]] = {}
    for item in top["placements"].items():
        name, positions = _placement(item)
        if name in placements:
            raise item.error(f"repeats the placement {name!r}")
        placements[name] = positions
    experiences = by_id(top["experiences"], parse=_photo)
    lists = {name: form.parse(top[name]) for name, form in LISTS.items()}
    of_photos = {id: photo.floor for id, photo in experiences.items()}
    of_notes = {note.id: note.floor for note in lists["notes"]}
    check_floors_of(top["experiences"], of_photos, what="photo", floors=lists["floors"])
    check_floors_of(top["notes"], of_notes, what="note", floors=lists["floors"])
    return MapJson(
        revision=top["revision"].integer(default=0, largest=MAX_NUMBER),
        next_id=top["next_id"].integer(default=0, largest=MAX_NUMBER + 1),
        georeference=_georeference(top["georeference"]),
        placements=placements,
        experiences=experiences,
        title=None if top["title"].missing else top["title"].text(),
        description=_description(top["description"]),
        unplaced=by_id(top["unplaced"], parse=_unplaced),
        **lists,
    )


def format_map_json(map_: Map, *, by_gps_anywhere: Collection[int] = ()) -> bytes:
    """Write the data of a map that a `.cfg` cannot hold; the same map always gives the same bytes.

    Photos with the ids `by_gps_anywhere` count as placed by GPS wherever the `.cfg` has them. Values that the
    reader would refuse raise MapJsonError.
    """
    photos = [
        record
        for e in map_.experiences
        if len(record := _photo_fields(e, by_gps_anywhere=e.id in by_gps_anywhere)) > 2
    ]
    content: dict[str, object] = {
        "format": FORMAT,
        "version": VERSION,
        **{name: text for name in ("title", "description") if (text := getattr(map_, name)) is not None},
        "revision": map_.revision,
        "next_id": map_.next_id,
        "georeference": georeference_fields(map_.georeference),
        "placements": [_placement_fields(placement) for placement in map_.placements],
        "experiences": photos,
        **({"unplaced": [_photo_fields(photo) for photo in map_.unplaced]} if map_.unplaced else {}),
        **{name: form.fields(there) for name, form in LISTS.items() if (there := getattr(map_, name))},
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    data = f"{text}\n".encode("utf-8", "surrogatepass")
    parse_map_json(data)
    return data


def _description(field: JsonField) -> str | None:
    if field.missing:
        return None
    text = field.text()
    if problem := DESCRIPTION.problem(text):
        raise field.error(problem)
    return text or None


def parse_georeference(value: object, *, where: str = "georeference") -> Georeference | None:
    """Parse a georeference in the form of `map.json`; None stays None."""
    return _georeference(JsonField(value, where, "$"))


def georeference_fields(georeference: Georeference | None) -> dict[str, object] | None:
    """Return a georeference in the form of `map.json`; None stays None."""
    if georeference is None:
        return None
    m = georeference.plane_from_pixel
    rows = [list(m[0:3]), list(m[3:6]), list(m[6:9])]
    return {"plane": georeference.plane, "plane_from_pixel": rows, "method": georeference.method}


def check_placement_name(name: str) -> str:
    """Check and return a placement's name, and that of its file: 1 to 60 letters, digits, `_` and `-`."""
    plain = name.replace("-", "").replace("_", "")
    if not (plain.isalnum() and len(name) <= 60):
        raise MapError(
            f"{name[:80]!r} is not a valid name for a placement",
            hint="use letters, digits, _ and -, at most 60",
        )
    return name


def _placement(item: JsonField) -> tuple[str, Mapping[int, MapPixel]]:
    fields = item.record(required=("name",), optional=("experiences",))
    try:
        name = check_placement_name(fields["name"].text())
    except MapJsonError:
        raise
    except MapError as error:
        raise fields["name"].error(error.message, hint=error.hint) from error
    return name, by_id(fields["experiences"], parse=_placed)


def _placed(item: JsonField) -> tuple[int, MapPixel]:
    fields = item.record(required=("id", "x_px", "y_px"))
    return fields["id"].integer(largest=MAX_NUMBER), MapPixel(
        fields["x_px"].pixels(), fields["y_px"].pixels()
    )


def _photo(item: JsonField) -> tuple[int, MapJsonPhoto]:
    fields = item.record(
        required=("id", "photo"), optional=("x_px", "y_px", "by_gps", "radius_px", "floor", *FACTS)
    )
    x, y = fields["x_px"], fields["y_px"]
    if x.missing != y.missing:
        raise item.error("has only one of x_px and y_px", hint="give both or none")
    facts, stated, radius = parse_facts(fields), fields["by_gps"], fields["radius_px"]
    radius_px = None if radius.missing else radius.number("0 or more", valid=lambda v: finite(v) and v >= 0)
    # files of version 0.7 lack by_gps
    guessed = "gps_accuracy_m" in facts and radius_px is None
    photo = MapJsonPhoto(
        fields["id"].integer(largest=MAX_NUMBER),
        fields["photo"].text(),
        position=None if x.missing else MapPixel(x.pixels(), y.pixels()),
        by_gps=guessed if stated.missing else stated.boolean(),
        radius_px=radius_px,
        floor=fields["floor"].integer(default=BASE_FLOOR, largest=MAX_NUMBER),
        **facts,
    )
    return photo.id, photo


def _unplaced(item: JsonField) -> tuple[int, UnplacedPhoto]:
    fields = item.record(required=("id", "photo"), optional=("gps_lat", "gps_lon", *FACTS))
    id, photo = fields["id"].integer(largest=MAX_NUMBER), fields["photo"].text()
    lat, lon = fields["gps_lat"], fields["gps_lon"]
    if lat.missing != lon.missing:
        raise item.error("has only one of gps_lat and gps_lon", hint="give both or none")
    gps = None if lat.missing else LatLon(_degrees(lat, most=90), _degrees(lon, most=180))
    return id, UnplacedPhoto(id, photo, gps=gps, **parse_facts(fields))


def _degrees(field: JsonField, *, most: int) -> float:
    return field.number(f"from -{most} to {most}", valid=lambda v: abs(v) <= most)


def _georeference(field: JsonField) -> Georeference | None:
    if field.missing:
        return None
    fields = field.record(required=("plane", "plane_from_pixel", "method"))
    rows = [row.items() for row in fields["plane_from_pixel"].items()]
    if [len(row) for row in rows] != [3, 3, 3]:
        raise fields["plane_from_pixel"].error("must be three rows of three numbers")
    matrix = tuple(cell.number("a finite number", valid=finite) for row in rows for cell in row)
    try:
        return Georeference(fields["plane"].text(), matrix, fields["method"].text())
    except GeoreferenceError as error:
        raise field.error(f"cannot be used: {error.message}", hint=error.hint) from error


def _position_fields(position: MapPixel) -> dict[str, object]:
    """Return x_px and y_px, or nothing for whole pixels: the `.cfg` holds those."""
    if float(position.x).is_integer() and float(position.y).is_integer():
        return {}
    return {"x_px": position.x, "y_px": position.y}


def _photo_fields(photo: Experience | UnplacedPhoto, *, by_gps_anywhere: bool = False) -> dict[str, object]:
    present = {name: value for name, value in fact_fields(photo).items() if value is not None}
    if not isinstance(photo, Experience):
        gps = {} if photo.gps is None else {"gps_lat": photo.gps.lat, "gps_lon": photo.gps.lon}
        return {"id": photo.id, "photo": photo.photo, **gps, **present}
    if by_gps_anywhere:
        return {"id": photo.id, "photo": photo.photo, **present, "by_gps": True}
    position = _position_fields(photo.position)
    if photo.by_gps or photo.radius_px is not None:
        # also for whole pixels: a different one in the `.cfg` then shows a manual edit
        position = {"x_px": photo.position.x, "y_px": photo.position.y}
    if photo.radius_px is not None:
        present |= {"radius_px": photo.radius_px}
    if photo.by_gps:
        present |= {"by_gps": True}
    elif photo.gps_accuracy_m is not None:
        present |= {"by_gps": False}
    if photo.floor != BASE_FLOOR:
        present |= {"floor": photo.floor}
    return {"id": photo.id, "photo": photo.photo, **position, **present}


def _placement_fields(placement: Placement) -> dict[str, object]:
    fields = (
        {"id": id, **_position_fields(position)} for id, position in sorted(placement.positions.items())
    )
    return {"name": check_placement_name(placement.name), "experiences": [f for f in fields if len(f) > 1]}
