"""Positions of photos by file name: a `.cfg`, a table, GeoJSON, KML, GeoPackage, or waypoints of a GPX file.

Tables are read by `position_tables.py`, GeoPackages by `geopackage.py` in a process of its own.
"""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element

from webapp.core.columns import PHOTO_FIELDS
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.texts import has_controls
from webapp.errors import GeoreferenceError, MapJsonError, TableError
from webapp.files import gate
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.exchange.geojson import EXPORT_WGS84, NO_PLANE, is_beyond_degrees, stated_plane
from webapp.files.exchange.gpx import GpxWaypoint, read_gpx
from webapp.files.exchange.xml import child_text, local_name, number, walk
from webapp.files.gate import Budget
from webapp.files.json_fields import JsonField, parse_json
from webapp.files.maps import geopackage
from webapp.files.maps.cfg import read_cfg
from webapp.files.maps.position_tables import ListedPosition, checked_heading, from_plane, latlon, read_table
from webapp.files.text_file import read_bytes

SUFFIXES = (".cfg", ".csv", ".tsv", ".txt", ".geojson", ".json", ".kml", ".gpx", ".gpkg")
FORMATS = "a .cfg, a table of file names and positions, GeoJSON, KML, GeoPackage, or GPX with waypoints"

_NAMES = PHOTO_FIELDS.names["name"]
_MOST_VALUES = 1_000_000
"""Of a GeoJSON: several seconds of reading; a point has about ten."""

_BUDGET = Budget(memory_mb=300.0, cpu_s=10.0, wait_s=60.0)
"""Of reading a GeoPackage; the most points that it may have take a second."""


@dataclass(frozen=True, slots=True)
class Positions:
    by_name: Mapping[str, LatLon | MapPixel]  # Paths with forward slashes; all values of one kind
    # Size of the image to which pixels refer (from a `.cfg`); None for degrees and if unknown.
    image_size: tuple[int, int] | None = None
    # Degrees clockwise from north, where the list has them.
    headings_deg: Mapping[str, float] = field(default_factory=dict)
    # What a GeoPackage says of photos.
    notes: Mapping[str, str] = field(default_factory=dict)
    # Names shared by several points of a GeoJSON, KML, GeoPackage or GPX, which are left out of `by_name`.
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

        The list may leave out the suffixes of file names.
        """
        entry = self._entry(name)
        return None if entry is None else self.by_name[entry]

    def heading_of(self, name: str) -> float | None:
        """Return the heading of a photo, looked up like `find`; None if the list has none."""
        return self.headings_deg.get(self._entry(name) or "")

    def note_of(self, name: str) -> str | None:
        """Return the note on a photo, looked up like `find`; None if the list has none."""
        return self.notes.get(self._entry(name) or "")

    def _entry(self, name: str) -> str | None:
        if name in self.by_name:
            return name
        path = PurePosixPath(name)
        same = self._by_last.get(path.name) or self._by_last.get(path.stem, [])
        return same[0] if len(same) == 1 else None


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
    if is_geopackage(path):
        return _of_points(_geopackage(path), where=str(path))
    data = read_bytes(path, error=TableError)
    match data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1]:
        case b"{":
            entries = _geojson(data, where=str(path))
        case b"<":
            entries = list(_xml(data, where=str(path)))
        case _:
            return _of_table(read_table(data, columns, where=str(path), formats=FORMATS))
    return _of_points(entries, where=str(path))


def _of_points(entries: Sequence[ListedPosition], *, where: str) -> Positions:
    if not entries:
        raise TableError("no point in it has a name", where=where, hint=f"use {FORMATS}")
    counts = Counter(entry.name for entry in entries)
    repeated = tuple(name for name, count in counts.items() if count > 1)
    return _positions([entry for entry in entries if counts[entry.name] == 1], repeated)


def _of_table(entries: Sequence[ListedPosition]) -> Positions:
    seen: set[str] = set()
    for entry in entries:
        if entry.name in seen:
            raise TableError(
                f"the photo {entry.name!r} is listed twice", where=entry.where, hint="keep one of the lines"
            )
        seen.add(entry.name)
    return _positions(entries)


def _positions(entries: Sequence[ListedPosition], repeated: tuple[str, ...] = ()) -> Positions:
    headings = {entry.name: entry.heading_deg for entry in entries if entry.heading_deg is not None}
    by_name = {entry.name: entry.position for entry in entries}
    notes = {entry.name: entry.note for entry in entries if entry.note}
    return Positions(by_name, headings_deg=headings, notes=notes, repeated=repeated)


def is_geopackage(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(geopackage.MAGIC)) == geopackage.MAGIC
    except OSError:
        return False


def _geopackage(path: Path) -> list[ListedPosition]:
    """Read the points of a GeoPackage that name photos."""
    beside = path.with_name(f"{path.name}-wal")
    if beside.exists() and beside.stat().st_size:
        raise TableError(
            "another program has changes of the GeoPackage that are not in the file yet",
            where=str(path),
            hint="close it in QGIS, or copy it there",
        )
    arguments = {"path": str(path), "suffixes": sorted(PHOTO_SUFFIXES)}
    found: list[ListedPosition] = []
    messages = gate.run(f"{geopackage.__name__}:rows", arguments, budget=_BUDGET)
    with closing(messages):  # type: ignore[type-var]
        for message in messages:
            plane, rows = json.loads(message)
            entries = [_row(row, in_plane=plane is not None) for row in rows]
            found += entries if plane is None else _converted(entries, plane, where=str(path))
    return found


def _row(row: Sequence[Any], *, in_plane: bool) -> ListedPosition:
    name, x, y, turned, note, here = row
    if not in_plane and is_beyond_degrees(x, y):
        raise TableError(NO_PLANE.format(f"{x:.10g}, {y:.10g}"), where=here, hint=EXPORT_WGS84)
    heading = None if turned is None else checked_heading(float(turned), here)
    position = MapPixel(x, y) if in_plane else latlon(y, x, where=here)
    kept = "".join(c for c in note or "" if c in "\n\t" or not has_controls(c)).strip()
    return ListedPosition(name, position, heading, here, kept or None)


def _converted(entries: Sequence[ListedPosition], plane: str, *, where: str) -> list[ListedPosition]:
    try:
        return list(from_plane(entries, plane))
    except GeoreferenceError as error:
        message = f"the coordinate system {plane[:80]!r} is not known"
        raise TableError(message, where=where, hint=EXPORT_WGS84) from error


def _geojson(data: bytes, *, where: str) -> list[ListedPosition]:
    """Read the points of a GeoJSON; other features are skipped."""
    try:
        top = parse_json(data, where=where, most_values=_MOST_VALUES)
        listed = top.value.get("features") if isinstance(top.value, dict) else None
        plane = stated_plane(top.value, error=TableError)
        features = JsonField(listed, "$.features", where).items()
        found = [_feature(item, in_plane=plane is not None) for item in features]
    except MapJsonError as error:
        raise TableError(error.message, where=error.where, hint=error.hint) from error
    entries = [entry for entry in found if entry is not None]
    return entries if plane is None else list(from_plane(entries, plane))


def _feature(item: JsonField, *, in_plane: bool) -> ListedPosition | None:
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
    heading = None if turned is None else checked_heading(float(turned), here)
    if not in_plane and is_beyond_degrees(lon, lat):
        raise TableError(NO_PLANE.format(f"{lon:.10g}, {lat:.10g}"), where=here, hint=EXPORT_WGS84)
    position = MapPixel(lon, lat) if in_plane else latlon(lat, lon, where=here)
    return ListedPosition(name.strip().replace("\\", "/"), position, heading, here)


def _headings() -> Iterator[str]:
    for name in PHOTO_FIELDS.names["heading"]:
        yield from (name, f"{name}_deg")


def _xml(data: bytes, *, where: str) -> Iterator[ListedPosition]:
    """Read the waypoints of a GPX file, or the points of a KML."""
    root = next((local_name(element) for _, element in walk(io.BytesIO(data), whole=())), "")
    if root == "gpx":
        for item in read_gpx(io.BytesIO(data)):
            if isinstance(item, GpxWaypoint):
                here = f"{where}: waypoint {item.number}"
                for name in _photos_of(item):
                    position = latlon(item.point.lat, item.point.lon, where=here)
                    course = item.point.course_deg
                    heading = None if course != course else checked_heading(course, here)
                    yield ListedPosition(name, position, heading, here)
    elif root == "kml":
        yield from _kml(data, where=where)
    else:
        raise TableError(f"<{root[:40]}> is neither KML nor GPX", where=where, hint=f"use {FORMATS}")


def _photos_of(waypoint: GpxWaypoint) -> list[str]:
    """Return the photos to which a waypoint has links, or else its name."""
    names = [unquote(urlsplit(link.replace("\\", "/")).path).lstrip("/") for link in waypoint.links]
    photos = [name for name in names if PurePosixPath(name).suffix.lower() in PHOTO_SUFFIXES]
    return photos or [name for name in [waypoint.name.replace("\\", "/")] if name]


def _kml(data: bytes, *, where: str) -> Iterator[ListedPosition]:
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
        heading = None if turned is None or turned != turned else checked_heading(turned, here)
        yield ListedPosition(name, latlon(number(numbers[1]), number(numbers[0]), where=here), heading, here)


def _placemark_name(mark: Element) -> str:
    """Return the photo's name in a placemark: from its extended data, or else the placemark's own name."""
    facts = {
        str(part.get("name", "")).lower(): child_text(part, "value")
        for part in mark.iter()
        if local_name(part) == "Data"
    }
    return next((facts[key] for key in _NAMES if facts.get(key)), "") or child_text(mark, "name")
