"""Positions of photos by file name: a `.cfg`, a table, GeoJSON, KML, or the waypoints of a GPX file.

A table has any delimiter, and columns of names, of positions in degrees or in pixels of the satellite image,
and optionally of headings; they are named by its header or by the caller (`webapp.core.columns`).
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element

from webapp.core.columns import PHOTO_FIELDS, Columns, guess_columns, parse_columns
from webapp.core.geo.fit import check_positions
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, MapJsonError, TableError, TrackError
from webapp.files.exchange.gpx import GpxWaypoint, read_gpx
from webapp.files.exchange.xml import child_text, local_name, number, walk
from webapp.files.json_fields import JsonField, parse_json
from webapp.files.maps.cfg import read_cfg
from webapp.files.text_file import cell_text, delimiter_of, numbered_lines, read_bytes, split_row

FORMATS = "a .cfg, a table of file names and positions, GeoJSON, KML, or GPX with waypoints"

_NAMES = PHOTO_FIELDS.names["name"]
_UNKNOWN = ("", "-")
_LONGEST_ANGLE = 60
"""Characters; matching a long sequence of digits would take cubic time."""

_MOST_VALUES = 1_000_000
"""Of a GeoJSON: several seconds of reading; a point has about ten."""

_ANGLE = re.compile(
    r"""([NSEW]?)\s*([+-]?[0-9]+(?:\.[0-9]*)?)\s*(?:deg|°|º)?\s*
    (?:([0-9]+(?:\.[0-9]*)?)\s*['′’]?\s*)?(?:([0-9]+(?:\.[0-9]*)?)\s*(?:"|″|'')?\s*)?([NSEW]?)""",
    re.IGNORECASE | re.VERBOSE,
)
"""Degrees, optionally with minutes, seconds, and a letter on one side."""


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions of photos, by their names in the list."""

    by_name: Mapping[str, LatLon | MapPixel]  # Paths with forward slashes; all values of one kind
    # Size of the image to which pixels refer (from a `.cfg`); None for degrees and if unknown.
    image_size: tuple[int, int] | None = None
    # Degrees clockwise from north, where the list has them.
    headings_deg: Mapping[str, float] = field(default_factory=dict)
    # Names shared by several points of a GeoJSON, KML or GPX, which are left out of `by_name`.
    repeated: tuple[str, ...] = ()
    _by_last: dict[str, list[str]] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.by_name:
            self._by_last.setdefault(PurePosixPath(name).name, []).append(name)

    @property
    def in_pixels(self) -> bool:
        """Whether they are map pixels, not degrees."""
        return any(isinstance(position, MapPixel) for position in self.by_name.values())

    def find(self, name: str) -> LatLon | MapPixel | None:
        """Find the position of a photo by its path, or else by its file name if that is unique in the list.

        Args:
            name: Path with forward slashes.
        """
        entry = self._entry(name)
        return None if entry is None else self.by_name[entry]

    def heading_of(self, name: str) -> float | None:
        """Return the heading of a photo, looked up like `find`; None if the list has none."""
        return self.headings_deg.get(self._entry(name) or "")

    def _entry(self, name: str) -> str | None:
        if name in self.by_name:
            return name
        same = self._by_last.get(PurePosixPath(name).name, [])
        return same[0] if len(same) == 1 else None


@dataclass(frozen=True, slots=True)
class _Entry:
    """One photo of a list; `where` is its location in the list, for errors."""

    name: str
    position: LatLon | MapPixel
    heading_deg: float | None
    where: str


def read_positions(path: Path, *, columns: str | None = None) -> Positions:
    """Read a list of positions; formats other than `.cfg` are recognised by content.

    Args:
        columns: Meaning of a table's columns, as `name=File, lat=Latitude, lon=Longitude`; None to guess it
            from the header.

    Raises:
        TableError, TrackError: The list is malformed (with the line) or has no position; or a table lists a
            photo twice.
        MapError: The `.cfg` is malformed.
        UsageError: `columns` does not fit the table.
    """
    if path.suffix.lower() == ".cfg":
        map_ = read_cfg(path).map
        size = (map_.satellite.width, map_.satellite.height)
        return Positions({e.photo: e.position for e in map_.experiences}, size)
    data = read_bytes(path, error=TableError)
    match data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1]:
        case b"{":
            entries = list(_geojson(data, where=str(path)))
        case b"<":
            entries = list(_xml(data, where=str(path)))
        case _:
            return _of_table(list(_table(data, columns, where=str(path))))
    if not entries:
        raise TableError("no point in it has a name", where=str(path), hint=f"use {FORMATS}")
    counts = Counter(entry.name for entry in entries)
    repeated = tuple(name for name, count in counts.items() if count > 1)
    return _positions([entry for entry in entries if counts[entry.name] == 1], repeated)


def _of_table(entries: Sequence[_Entry]) -> Positions:
    seen: set[str] = set()
    for entry in entries:
        if entry.name in seen:
            raise TableError(
                f"the photo {entry.name!r} is listed twice", where=entry.where, hint="keep one of the lines"
            )
        seen.add(entry.name)
    return _positions(entries)


def _positions(entries: Sequence[_Entry], repeated: tuple[str, ...] = ()) -> Positions:
    headings = {entry.name: entry.heading_deg for entry in entries if entry.heading_deg is not None}
    by_name = {entry.name: entry.position for entry in entries}
    return Positions(by_name, headings_deg=headings, repeated=repeated)


def _table(data: bytes, columns: str | None, *, where: str) -> Iterator[_Entry]:
    """Read a table; rows without a position, as exiftool writes for photos without GPS, are skipped."""
    lines = [(f"{where}:{n}", line) for n, line in numbered_lines(io.BytesIO(data)) if line.strip()]
    if not lines:
        raise TableError("the file is empty", where=where, hint=f"use {FORMATS}")
    delimiter = delimiter_of(lines[0][1]) or ";"
    header = split_row(lines[0][1], delimiter)
    try:
        known = (
            parse_columns(columns, header, fields=PHOTO_FIELDS)
            if columns
            else guess_columns(header, fields=PHOTO_FIELDS)
        )
    except TrackError as error:
        raise TableError(error.message, where=f"{where}:1", hint=error.hint) from error
    row = _Row(known, decimal_comma=delimiter != ",")
    if columns and row.is_data(header):
        lines.insert(0, lines[0])  # a table without a header
    for place, line in lines[1:]:
        entry = row.entry(split_row(line, delimiter), place)
        if entry is not None:
            yield entry


@dataclass(frozen=True, slots=True)
class _Row:
    """Reads rows of a table."""

    columns: Columns
    decimal_comma: bool

    def entry(self, fields: Sequence[str], where: str) -> _Entry | None:
        sides = ("lat", "lon") if "lat" in self.columns else ("x", "y")
        texts = [self.text(fields, side) for side in sides]
        name = self.text(fields, "name").replace("\\", "/")
        if all(text in _UNKNOWN for text in texts) or not name:
            return None
        first, second = (self.number(fields, side, where) for side in sides)
        position = MapPixel(first, second) if sides == ("x", "y") else _latlon(first, second, where)
        heading = None
        if self.text(fields, "heading") not in _UNKNOWN:
            heading = _heading(self.number(fields, "heading", where), where)
        return _Entry(name, position, heading, where)

    def is_data(self, fields: Sequence[str]) -> bool:
        """Return whether the first line is a row rather than a header."""
        try:
            return self.entry(fields, "") is not None
        except TableError:
            return False

    def text(self, fields: Sequence[str], name: str) -> str:
        column = self.columns.get(name)
        return cell_text(fields[column.index].strip()) if column and column.index < len(fields) else ""

    def number(self, fields: Sequence[str], name: str, where: str) -> float:
        text = self.text(fields, name)
        value = _angle(text.replace(",", ".") if self.decimal_comma else text)
        if value is None:
            hint = "use a decimal point" if "," in text else "write a plain number"
            raise TableError(f"{text[:40]!r} is not a number", where=where, hint=hint)
        against = self.text(fields, f"{name}_ref")[:1].upper()
        return (-abs(value) if against in ("S", "W") else value) * self.columns[name].scale


def _angle(text: str) -> float | None:
    """Parse a number, or degrees with minutes and seconds such as `50 deg 5' 12.3" N`; None if invalid."""
    found = _ANGLE.fullmatch(text.strip()) if len(text) <= _LONGEST_ANGLE else None
    if found is None or (found[1] and found[5]):
        return None
    degrees, minutes, seconds = (float(part or 0.0) for part in found.group(2, 3, 4))
    value = abs(degrees) + minutes / 60 + seconds / 3600
    is_negative = found[2].startswith("-") != ((found[1] or found[5]).upper() in ("S", "W"))
    return -value if is_negative else value


def _geojson(data: bytes, *, where: str) -> Iterator[_Entry]:
    """Read the points of a GeoJSON; other features are skipped."""
    try:
        top = parse_json(data, where=where, most_values=_MOST_VALUES)
        listed = top.value.get("features") if isinstance(top.value, dict) else None
        for item in JsonField(listed, "$.features", where).items():
            entry = _feature(item)
            if entry is not None:
                yield entry
    except MapJsonError as error:
        raise TableError(error.message, where=error.where, hint=error.hint) from error


def _feature(item: JsonField) -> _Entry | None:
    feature = item.value if isinstance(item.value, dict) else {}
    geometry, properties = feature.get("geometry"), feature.get("properties")
    facts = (
        {str(key).lower(): value for key, value in properties.items()} if isinstance(properties, dict) else {}
    )
    name = next((value for key in _NAMES if isinstance(value := facts.get(key), str) and value.strip()), "")
    if not isinstance(geometry, dict) or geometry.get("type") != "Point" or not name:
        return None
    here = f"{item.where}: {item.path}"
    cells = JsonField(geometry.get("coordinates"), f"{item.path}.geometry.coordinates", item.where).items()
    if len(cells) < 2:
        raise TableError("a point has no longitude and latitude", where=here, hint="export it again")
    lon, lat = (cell.number("a number of degrees", valid=lambda value: True) for cell in cells[:2])
    turned = next((facts[key] for key in _headings() if isinstance(facts.get(key), int | float)), None)
    heading = None if turned is None else _heading(float(turned), here)
    return _Entry(name.strip().replace("\\", "/"), _latlon(lat, lon, here), heading, here)


def _headings() -> Iterator[str]:
    for name in PHOTO_FIELDS.names["heading"]:
        yield from (name, f"{name}_deg")


def _xml(data: bytes, *, where: str) -> Iterator[_Entry]:
    """Read the waypoints of a GPX file, or the points of a KML."""
    root = next((local_name(element) for _, element in walk(io.BytesIO(data), whole=())), "")
    if root == "gpx":
        for item in read_gpx(io.BytesIO(data)):
            if isinstance(item, GpxWaypoint) and item.name:
                here = f"{where}: waypoint {item.number}"
                position = _latlon(item.point.lat, item.point.lon, here)
                course = item.point.course_deg
                heading = None if course != course else _heading(course, here)
                yield _Entry(item.name.replace("\\", "/"), position, heading, here)
    elif root == "kml":
        yield from _kml(data, where=where)
    else:
        raise TableError(f"<{root[:40]}> is neither KML nor GPX", where=where, hint=f"use {FORMATS}")


def _kml(data: bytes, *, where: str) -> Iterator[_Entry]:
    count = 0
    for _, mark in walk(io.BytesIO(data), whole={"Placemark"}):
        if local_name(mark) != "Placemark":
            continue
        count += 1
        here = f"{where}: placemark {count}"
        point = next((part for part in mark.iter() if local_name(part) == "Point"), None)
        name = _placemark_name(mark).replace("\\", "/")
        numbers = child_text(point, "coordinates").split(",") if point is not None else []
        if not name or len(numbers) < 2:
            continue
        turned = next((number(part.text) for part in mark.iter() if local_name(part) == "heading"), None)
        heading = None if turned is None or turned != turned else _heading(turned, here)
        yield _Entry(name, _latlon(number(numbers[1]), number(numbers[0]), here), heading, here)


def _placemark_name(mark: Element) -> str:
    """Return the photo's name in a placemark: from its extended data, or else the placemark's own name."""
    facts = {
        str(part.get("name", "")).lower(): child_text(part, "value")
        for part in mark.iter()
        if local_name(part) == "Data"
    }
    return next((facts[key] for key in _NAMES if facts.get(key)), "") or child_text(mark, "name")


def _heading(heading: float, where: str) -> float:
    if not -360.0 <= heading <= 360.0:
        raise TableError(f"the heading {heading:g} is not from 0 to 360", where=where)
    return heading % 360.0


def _latlon(lat: float, lon: float, where: str) -> LatLon:
    position = LatLon(lat, lon)
    try:
        check_positions([position])
    except GeoreferenceError as error:
        raise TableError(error.message, where=where, hint=error.hint) from error
    return position
