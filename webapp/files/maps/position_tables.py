"""Tables of photos and their positions, as people and programs of photogrammetry write them.

A table has any delimiter, and columns of names, of positions and optionally of headings, which are named by
its header or by the caller (`webapp.core.columns`). Lists of ODM (`geo.txt`) have no header but a coordinate
system in the first line; exports of Metashape state theirs in a comment.
"""

from __future__ import annotations

import codecs
import io
import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from webapp.core.columns import (
    LONGEST_HEADER,
    PHOTO_FIELDS,
    Column,
    Columns,
    guess_columns,
    parse_columns,
    read_header,
)
from webapp.core.geo.crs import crs_name, latlon_from_plane
from webapp.core.geo.fit import check_positions
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, TableError, TrackError
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.text_file import cell_text, delimiter_of, numbered_lines, split_row

_UNKNOWN = ("", "-")
_LONGEST_ANGLE = 60
"""Characters; matching a long sequence of digits would take cubic time."""

_ANGLE = re.compile(
    r"""([NSEW]?)\s*([+-]?[0-9]+(?:\.[0-9]*)?)\s*(?:deg|°|º)?\s*
    (?:([0-9]+(?:\.[0-9]*)?)\s*['′’]?\s*)?(?:([0-9]+(?:\.[0-9]*)?)\s*(?:"|″|'')?\s*)?([NSEW]?)""",
    re.IGNORECASE | re.VERBOSE,
)
"""Degrees, optionally with minutes, seconds, and a letter on one side."""

_SEPARATOR = re.compile(r"\"?sep=(.)\"?[;,\t|]*", re.IGNORECASE)
"""A first line for Excel."""

_STATED = re.compile(r"#\s*CoordinateSystem:\s*(.+)", re.IGNORECASE)
_ODM = re.compile(r"(EPSG:\d{4,6}|WGS84\s+UTM\s+\d{1,2}\s*[NS]|\+proj=.+|\+init=.+)", re.IGNORECASE)
_UTM = re.compile(r"WGS84\s+UTM\s+(\d{1,2})\s*([NS])", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+")
_METRES = re.compile(r"[\[(]\s*(m|meters?|metres?)\s*[\])]|easting|northing|x/east|y/north|geo_[xy]")
_IN_BRACKETS = (
    (re.compile(r"[\[(]\s*decimal[\s_]*degrees?\s*[\])]"), "[deg]"),
    (re.compile(r"[\[(]\s*(grad|stupne|grados|degres|degrees?|dd)\s*[\])]"), "[deg]"),
    (re.compile(r"[\[(]\s*(wgs[\s_-]*84|epsg:4326|n|e|no?rd|ost|sud|est)\s*[\])]"), ""),
)
_UNIT_METRES = re.compile(r"[\s_]*[\[(]\s*(m|meters?|metres?)\s*[\])]")
_ANGLES = {"omega", "phi", "kappa"}
_LEAST_HEADERS = 2
"""Cells by which a line is a header."""

_LARGEST_GROUND_POINT = 6
"""Columns before the name of a line of ODM's `gcp_list.txt` end with it: x y z, pixel x y, photo."""


@dataclass(frozen=True, slots=True)
class ListedPosition:
    """One photo of a list; `where` is its location in the list, for errors."""

    name: str
    position: LatLon | MapPixel
    heading_deg: float | None
    where: str
    note: str | None = None


Lines = Sequence[tuple[str, str]]
"""Lines of a file, each with its location."""


def read_table(data: bytes, columns: str | None, *, where: str, formats: str) -> list[ListedPosition]:
    """Read a table; rows without a position, as exiftool writes for photos without GPS, are skipped.

    Args:
        columns: Meaning of the columns; None to guess it from the header.

    Raises:
        TableError, TrackError: It is malformed, with the line.
        UsageError: `columns` does not fit.
    """
    text = io.BytesIO(_utf8(data))
    numbered: Lines = [(f"{where}:{n}", line) for n, line in numbered_lines(text) if line.strip()]
    if not numbered:
        raise TableError("the file is empty", where=where, hint=f"use {formats}")
    separator = _SEPARATOR.fullmatch(numbered[0][1].strip())
    lines = numbered[1:] if separator else numbered
    plane, lines = _preamble(lines) if lines else (None, lines)
    if not lines:
        raise TableError("the table has no rows", where=where, hint=f"use {formats}")
    is_odm = _ODM.fullmatch(numbered[0][1].strip()) and _header_words(lines[0][1]) < _LEAST_HEADERS
    if plane is not None and is_odm:
        return list(from_plane(_odm_rows(lines), plane))
    delimiter = separator[1] if separator else delimiter_of(lines[0][1]) or ";"
    rows = list(_rows(lines, columns, delimiter=delimiter, in_plane=plane is not None))
    return rows if plane is None else list(from_plane(rows, plane))


def _utf8(data: bytes) -> bytes:
    """Return a table in UTF-16, as spreadsheets write, as UTF-8; others unchanged."""
    if not data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data
    return data.decode("utf-16", "replace").encode()


def _preamble(lines: Lines) -> tuple[str | None, Lines]:
    """Return the coordinate system that the lines before the header state, and the others."""
    place, line = lines[0]
    plane = odm_plane(line, place)
    if plane is not None:
        return plane, lines[1:]
    for number, (place, line) in enumerate(lines):
        stated = _STATED.fullmatch(line.strip())
        if stated is not None:
            plane = _plane(stated[1].strip(), place)
        elif not line.lstrip().startswith("#") or _header_words(line) >= _LEAST_HEADERS:
            return plane, lines[number:]
    return plane, ()


def odm_plane(line: str, where: str) -> str | None:
    """Return the coordinate system that the first line of a list of ODM states; None for another line."""
    return _plane(line.strip(), where) if _ODM.fullmatch(line.strip()) else None


def _header_words(line: str) -> int:
    """Count the cells of a line that are known headers."""
    delimiter = delimiter_of(line.lstrip("# ")) or ";"
    cells = [cell for cell in split_row(line, delimiter) if cell]
    return sum(read_header(_plain(cell), fields=PHOTO_FIELDS).field is not None for cell in cells)


def _plane(text: str, where: str) -> str:
    utm = _UTM.fullmatch(text)
    if utm is not None:
        text = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    try:
        return crs_name(text)
    except GeoreferenceError as error:
        raise TableError(error.message, where=where, hint=error.hint) from error


def _rows(lines: Lines, columns: str | None, *, delimiter: str, in_plane: bool) -> Iterator[ListedPosition]:
    header = split_row(lines[0][1], delimiter)
    known = _columns(header, columns, where=lines[0][0], in_plane=in_plane)
    row = _Row(known, delimiter=delimiter, in_plane=in_plane)
    first = 0 if columns and row.is_data(header) else 1
    for place, line in lines[first:]:
        entry = row.entry(split_row(line, delimiter), place)
        if entry is not None:
            yield entry


def _columns(header: Sequence[str], columns: str | None, *, where: str, in_plane: bool) -> Columns:
    if columns:
        return parse_columns(columns, header, fields=PHOTO_FIELDS)
    plain = [_plain(cell) for cell in header]
    if _is_of_ground_points(plain):
        raise TableError(
            "these are ground control points of an image, not positions of photos",
            where=where,
            hint="give them as control points of the satellite image",
        )
    if in_plane:
        plain = [_UNIT_METRES.sub("", cell) for cell in plain]
    else:
        _check_pixels(plain, where=where)
    try:
        return guess_columns(plain, fields=PHOTO_FIELDS)
    except TrackError as error:
        is_photo = PurePosixPath(header[0].strip()).suffix.lower() in PHOTO_SUFFIXES if header else False
        hint = "the first line is a photo, not a header: assign columns by number: name=1, lat=2, lon=3"
        raise TableError(error.message, where=where, hint=hint if is_photo else error.hint) from error


def _check_pixels(header: Sequence[str], *, where: str) -> None:
    """Refuse x and y that are no pixels. Raises TableError."""
    read = [read_header(cell, fields=PHOTO_FIELDS) for cell in header]
    sides = [cell for cell, one in zip(header, read, strict=True) if one.field in ("x", "y")]
    if any(one.field == "lat" or one.unit == "px" for one in read) or not sides:
        return
    if any(map(_METRES.search, sides)):
        raise TableError(
            "the positions are in metres, and the table states no coordinate system",
            where=where,
            hint="export them in degrees (WGS 84), or begin with a line such as EPSG:32633",
        )
    others = {read_header(cell).field for cell in header} & {"z", "height"}
    if others or _ANGLES & {cell.strip() for cell in header}:
        raise TableError(
            "x and y with heights or angles are no pixels, and the table states no coordinate system",
            where=where,
            hint="begin with a line such as EPSG:32633, or if they are degrees name the columns: "
            "name=..., lon=x, lat=y",
        )


def _is_of_ground_points(header: Sequence[str]) -> bool:
    return {"mapx", "mapy"} <= {cell.strip() for cell in header}


def _plain(cell: str) -> str:
    """Return a header in lower case, without accents, with units as columns have them; others unchanged."""
    if len(cell.strip()) > LONGEST_HEADER:
        return cell
    parts = unicodedata.normalize("NFKD", cell.strip().lower().replace("ß", "ss"))
    text = "".join(c for c in parts if not unicodedata.combining(c))
    for pattern, unit in _IN_BRACKETS:
        text = pattern.sub(unit, text)
    return text.strip()


@dataclass(frozen=True, slots=True)
class _Row:
    columns: Columns
    delimiter: str
    in_plane: bool  # Whether the table states a coordinate system: numbers are east and north in it

    def entry(self, fields: Sequence[str], where: str) -> ListedPosition | None:
        sides = ("lat", "lon") if "lat" in self.columns else ("x", "y")
        texts = [self.text(fields, side) for side in sides]
        name = self.text(fields, "name").replace("\\", "/")
        if all(text in _UNKNOWN for text in texts) or not name or name.startswith("#"):
            return None
        first, second = (self.number(fields, side, where) for side in sides)
        if self.in_plane:
            position: LatLon | MapPixel = MapPixel(*((first, second) if sides[0] == "x" else (second, first)))
        else:
            position = MapPixel(first, second) if sides == ("x", "y") else latlon(first, second, where=where)
        heading = None
        if self.text(fields, "heading") not in _UNKNOWN:
            heading = checked_heading(self.number(fields, "heading", where), where)
        return ListedPosition(name, position, heading, where)

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
        value = _angle(text.replace(",", ".") if self._has_decimal_comma(text, name) else text)
        if value is None:
            hint = "use a decimal point" if "," in text else "write a plain number"
            raise TableError(f"{text[:40]!r} is not a number", where=where, hint=hint)
        against = self.text(fields, f"{name}_ref")[:1].upper()
        return (-abs(value) if against in ("S", "W") else value) * self.columns[name].scale

    def _has_decimal_comma(self, text: str, name: str) -> bool:
        """Return whether a comma is that of a decimal, also in a quoted cell of a table with commas."""
        if self.delimiter != ",":
            return True
        is_pixel = name in ("x", "y")
        return bool(_DECIMAL_COMMA.fullmatch(text)) and not (is_pixel and _THOUSANDS.fullmatch(text))


def _odm_rows(lines: Lines) -> Iterator[ListedPosition]:
    """Read the rows of ODM's `geo.txt`: name, x, y, and optionally z, yaw and more."""
    for place, line in lines:
        cells = line.split()
        if line.lstrip().startswith("#"):
            continue
        numbers = [bool(_NUMBER.fullmatch(cell)) for cell in cells]
        if len(cells) >= _LARGEST_GROUND_POINT and all(numbers[:5]) and not numbers[5]:
            raise TableError(
                "these are ground control points in photos (gcp_list.txt), not positions of photos",
                where=place,
                hint="ODM's positions of photos are in geo.txt",
            )
        if len(cells) < 3 or not all(numbers[1:3]):
            raise TableError("a line needs a name, x and y", where=place, hint="write: name x y [z] [yaw]")
        columns = {
            "name": Column(0, 1.0),
            "x": Column(1, 1.0),
            "y": Column(2, 1.0),
            "heading": Column(4, 1.0),
        }
        entry = _Row(columns, delimiter=" ", in_plane=True).entry(cells, place)
        if entry is not None:
            yield entry


def from_plane(
    entries: Iterator[ListedPosition] | Sequence[ListedPosition], plane: str
) -> Iterator[ListedPosition]:
    """Convert positions from east and north in a coordinate system."""
    listed = list(entries)
    found = latlon_from_plane(plane, [tuple(entry.position) for entry in listed])
    for entry, (lat, lon) in zip(listed, found.tolist(), strict=True):
        if not math.isfinite(lat):
            raise TableError(f"the position is outside {plane[:40]}", where=entry.where)
        yield replace(entry, position=latlon(lat, lon, where=entry.where))


def _angle(text: str) -> float | None:
    """Parse a number, or degrees with minutes and seconds such as `50 deg 5' 12.3" N`; None if invalid."""
    found = _ANGLE.fullmatch(text.strip()) if len(text) <= _LONGEST_ANGLE else None
    if found is None or (found[1] and found[5]):
        return None
    degrees, minutes, seconds = (float(part or 0.0) for part in found.group(2, 3, 4))
    value = abs(degrees) + minutes / 60 + seconds / 3600
    is_negative = found[2].startswith("-") != ((found[1] or found[5]).upper() in ("S", "W"))
    return -value if is_negative else value


def checked_heading(heading: float, where: str) -> float:
    """Return a heading from 0 to 360 degrees. Raises TableError."""
    if not -360.0 <= heading <= 360.0:
        raise TableError(f"the heading {heading:g} is not from 0 to 360", where=where)
    return heading % 360.0


def latlon(lat: float, lon: float, *, where: str) -> LatLon:
    """Return a position that is on the Earth. Raises TableError."""
    position = LatLon(lat, lon)
    try:
        check_positions([position])
    except GeoreferenceError as error:
        raise TableError(error.message, where=where, hint=error.hint) from error
    return position
