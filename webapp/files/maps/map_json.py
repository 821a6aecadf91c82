"""The data of a map that a `.cfg` cannot hold, in JSON next to it; `maps/FORMAT.md` has the schema."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from dataclasses import fields as dataclass_fields
from datetime import datetime

from webapp.core.blur import MOST_BOXES, BlurBox
from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.model import Experience, Map, PhotoSource, Placement, UnplacedPhoto
from webapp.core.mapmodel.notes import MapNote
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import GeoreferenceError, MapError, MapJsonError
from webapp.files.json_fields import JsonField, by_id, finite, parse_json
from webapp.files.maps.control_points import control_point_fields, parse_control_points
from webapp.files.maps.floors import check_floors_of, floors_fields, parse_floors
from webapp.files.maps.notes import notes_fields, parse_notes, parse_text
from webapp.files.maps.sources import parse_source, source_fields

FORMAT = "experience-map"
VERSION = 1

_FACTS = (
    "heading_deg",
    "fov_deg",
    "gps_accuracy_m",
    "taken_at",
    "name",
    "blurred",
    "source",
    "panorama",
    "note",
)


@dataclass(frozen=True, slots=True)
class MapJsonPhoto:
    """The data of one photo in `map.json`; None is unknown, or for the position, the `.cfg`'s."""

    photo: str
    position: MapPixel | None = None
    heading_deg: float | None = None
    fov_deg: float | None = None
    gps_accuracy_m: float | None = None
    taken_at: str | None = None
    name: str | None = None
    blurred: tuple[BlurBox, ...] = ()
    source: PhotoSource | None = None
    panorama: Panorama | None = None
    by_gps: bool = False
    radius_px: float | None = None
    note: str | None = None
    floor: int = BASE_FLOOR


@dataclass(frozen=True, slots=True)
class MapJson:
    """The content of `map.json`.

    Attributes
    ----------
    placements : mapping of str to mapping of int to MapPixel
        Of each further placement by name, its sub-pixel positions by id.
    experiences : mapping of int to MapJsonPhoto
        By id.
    title : str or None
        Title of the map.
    unplaced : mapping of int to MapJsonPhoto
        Photos in the tray, by id; none has a position.
    control_points : tuple of GroundControlPoint
        Sorted by name.
    notes : tuple of MapNote
        Sorted by id.
    floors : tuple of Floor
        Sorted by id.
    """

    revision: int = 0
    next_id: int = 0
    georeference: Georeference | None = None
    placements: Mapping[str, Mapping[int, MapPixel]] = field(default_factory=dict)
    experiences: Mapping[int, MapJsonPhoto] = field(default_factory=dict)
    title: str | None = None
    unplaced: Mapping[int, MapJsonPhoto] = field(default_factory=dict)
    control_points: tuple[GroundControlPoint, ...] = ()
    notes: tuple[MapNote, ...] = ()
    floors: tuple[Floor, ...] = ()


def parse_map_json(data: bytes, *, where: str = "map.json") -> MapJson:
    """Parse `map.json` strictly: missing required fields and unknown fields are errors.

    Parameters
    ----------
    data : bytes
        UTF-8.
    where : str
        Name of the file, for errors.

    Raises
    ------
    MapJsonError
        With the JSON path of the field, or line and column of a syntax error.
    """
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
    experiences, floors = by_id(top["experiences"], parse=_photo), parse_floors(top["floors"])
    notes = parse_notes(top["notes"])
    of_photos = {id: photo.floor for id, photo in experiences.items()}
    check_floors_of(top["experiences"], of_photos, what="photo", floors=floors)
    check_floors_of(top["notes"], {note.id: note.floor for note in notes}, what="note", floors=floors)
    return MapJson(
        revision=top["revision"].integer(default=0, largest=MAX_NUMBER),
        next_id=top["next_id"].integer(default=0, largest=MAX_NUMBER + 1),
        georeference=_georeference(top["georeference"]),
        placements=placements,
        experiences=experiences,
        title=None if top["title"].missing else top["title"].text(),
        unplaced=by_id(top["unplaced"], parse=_unplaced),
        control_points=parse_control_points(top["control_points"]),
        notes=notes,
        floors=floors,
    )


def format_map_json(map_: Map, *, by_gps_anywhere: Collection[int] = ()) -> bytes:
    """Write the data of a map that a `.cfg` cannot hold; the same map always gives the same bytes.

    Parameters
    ----------
    by_gps_anywhere : collection of int
        Ids of photos to mark as placed by GPS wherever the `.cfg` has them.

    Returns
    -------
    bytes
        UTF-8, indented, one final LF.

    Raises
    ------
    MapJsonError
        A value that the reader would refuse.
    """
    photos = [
        record
        for e in map_.experiences
        if len(record := _photo_fields(e, by_gps_anywhere=e.id in by_gps_anywhere)) > 2
    ]
    content: dict[str, object] = {
        "format": FORMAT,
        "version": VERSION,
        **({} if map_.title is None else {"title": map_.title}),
        "revision": map_.revision,
        "next_id": map_.next_id,
        "georeference": georeference_fields(map_.georeference),
        "placements": [_placement_fields(placement) for placement in map_.placements],
        "experiences": photos,
        **({"unplaced": [_photo_fields(photo) for photo in map_.unplaced]} if map_.unplaced else {}),
        **({"control_points": control_point_fields(map_.control_points)} if map_.control_points else {}),
        **({"notes": notes_fields(map_.notes)} if map_.notes else {}),
        **({"floors": floors_fields(map_.floors)} if map_.floors else {}),
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    data = f"{text}\n".encode("utf-8", "surrogatepass")
    parse_map_json(data)
    return data


def parse_georeference(value: object, *, where: str = "georeference") -> Georeference | None:
    """Parse a georeference in the form of `map.json`.

    Parameters
    ----------
    value : object
        Parsed JSON; None means no georeference.
    where : str
        Origin of the value, for errors.

    Raises
    ------
    MapJsonError
        With the JSON path of the field.
    """
    return _georeference(JsonField(value, where, "$"))


def georeference_fields(georeference: Georeference | None) -> dict[str, object] | None:
    """Return a georeference in the form of `map.json`; None stays None."""
    if georeference is None:
        return None
    m = georeference.plane_from_pixel
    rows = [list(m[0:3]), list(m[3:6]), list(m[6:9])]
    return {"plane": georeference.plane, "plane_from_pixel": rows, "method": georeference.method}


def check_placement_name(name: str) -> str:
    """Check and return a placement's name, which also names its file.

    Raises
    ------
    MapError
        The name does not consist of 1 to 60 letters, digits, `_` and `-`.
    """
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
        required=("id", "photo"), optional=("x_px", "y_px", "by_gps", "radius_px", "floor", *_FACTS)
    )
    x, y = fields["x_px"], fields["y_px"]
    if x.missing != y.missing:
        raise item.error("has only one of x_px and y_px", hint="give both or none")
    position = None if x.missing else MapPixel(x.pixels(), y.pixels())
    facts, stated, radius = _facts(fields, position), fields["by_gps"], fields["radius_px"]
    radius_px = None if radius.missing else radius.number("0 or more", valid=lambda v: finite(v) and v >= 0)
    # files of version 0.7 lack by_gps
    guessed = facts.gps_accuracy_m is not None and radius_px is None
    by_gps = guessed if stated.missing else stated.boolean()
    floor = fields["floor"].integer(default=BASE_FLOOR, largest=MAX_NUMBER)
    known = replace(facts, by_gps=by_gps, radius_px=radius_px, floor=floor)
    return fields["id"].integer(largest=MAX_NUMBER), known


def _unplaced(item: JsonField) -> tuple[int, MapJsonPhoto]:
    fields = item.record(required=("id", "photo"), optional=_FACTS)
    return fields["id"].integer(largest=MAX_NUMBER), _facts(fields, None)


def _facts(fields: Mapping[str, JsonField], position: MapPixel | None) -> MapJsonPhoto:
    heading, fov, accuracy, taken_at, name, blurred, source, panorama, note = (
        fields[name] for name in _FACTS
    )
    if not taken_at.missing:
        _check_time(taken_at)
    return MapJsonPhoto(
        photo=fields["photo"].text(),
        position=position,
        heading_deg=None if heading.missing else heading.number("from 0 to 360", valid=_is_heading),
        fov_deg=None if fov.missing else fov.number("above 0 and at most 360", valid=lambda v: 0 < v <= 360),
        gps_accuracy_m=None if accuracy.missing else accuracy.number("0 or more", valid=lambda v: v >= 0),
        taken_at=None if taken_at.missing else taken_at.text(),
        name=None if name.missing else name.text(),
        blurred=_boxes(blurred),
        source=None if source.missing else parse_source(source),
        panorama=None if panorama.missing else _panorama(panorama),
        note=parse_text(note),
    )


def _boxes(field: JsonField) -> tuple[BlurBox, ...]:
    """Read the blurred boxes of a photo."""
    boxes = tuple(_box(box) for box in field.items())
    if len(boxes) > MOST_BOXES:
        raise field.error(f"has {len(boxes)} boxes, more than {MOST_BOXES}", hint="draw larger boxes")
    return boxes


def _box(item: JsonField) -> BlurBox:
    """Read a box that lies inside the photo."""
    fields = item.record(required=BlurBox._fields)
    box = BlurBox(*(fields[side].number("a finite number", valid=finite) for side in BlurBox._fields))
    if not box.inside:
        raise item.error("is not a box inside the photo")
    return box


def _panorama(item: JsonField) -> Panorama:
    fields = item.record(required=(), optional=("masked",))
    return Panorama(tuple(_box(box) for box in fields["masked"].items()))


def panorama_fields(panorama: Panorama | None) -> dict[str, list[dict[str, float]]] | None:
    """Return the data of a panorama in the form of `map.json`; None stays None."""
    return None if panorama is None else {"masked": [box._asdict() for box in panorama.masked]}


def parse_panorama(value: object, *, where: str = "panorama") -> Panorama | None:
    """Parse the data of a panorama in the form of `map.json`; None stays None.

    Raises
    ------
    MapJsonError
    """
    return None if value is None else _panorama(JsonField(value, where, "$"))


def _is_heading(value: float) -> bool:
    return 0 <= value <= 360


def _check_time(taken_at: JsonField) -> None:
    try:
        datetime.fromisoformat(taken_at.text())
    except ValueError as error:
        raise taken_at.error(
            "is not a time in ISO 8601", hint="write it like 2026-04-30T14:05:00+02:00"
        ) from error


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
    known = {
        "heading_deg": photo.heading_deg,
        "fov_deg": photo.fov_deg,
        "gps_accuracy_m": photo.gps_accuracy_m,
        "taken_at": photo.taken_at,
        "name": photo.name,
        "blurred": [box._asdict() for box in photo.blurred] or None,
        "source": source_fields(photo.source),
        "panorama": panorama_fields(photo.panorama),
        "note": photo.note,
    }
    present = {name: value for name, value in known.items() if value is not None}
    if not isinstance(photo, Experience):
        return {"id": photo.id, "photo": photo.photo, **present}
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
