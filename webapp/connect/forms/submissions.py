"""Submissions in CSV as ODK Central, ODK Briefcase and KoboToolbox export them.

Which columns have photos follows from their values. Positions are in columns of one question, such as
`spot-Latitude` or `_spot_latitude`, or one column has latitude, longitude, altitude and accuracy. Repeats are
tables of their own, whose rows name that of the form in `PARENT_KEY`.

https://docs.getodk.org/central-submissions/, https://support.kobotoolbox.org/export_download.html
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.notes import NOTE_TEXT
from webapp.core.texts import has_controls
from webapp.errors import InputError
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.maps.geopackage import NOTES
from webapp.files.text_file import cell_text

MOST_ROWS = 100_000
_MOST_COLUMNS = 2000
_MOST_BYTES = 100_000_000
_MOST_CELL = 1_000_000
_LATITUDE = re.compile(r"(.*?)([\s_:/.-]?)(latitude|lat)", re.IGNORECASE | re.DOTALL)
_GEOPOINT = re.compile(r"[\[(]?\s*(-?\d+\.\d+)[\s,]+(-?\d+\.\d+)((?:\s+-?\d+(?:\.\d+)?){0,2})\s*[\])]?")
_TIMES = ("start", "end", "submissiondate", "_submission_time")
_OF_THE_FORM = frozenset(
    {*_TIMES, "today", "deviceid", "device id", "username", "phonenumber", "simserial",
     "subscriberid", "key", "parent_key", "set-of", "submitterid", "submittername", "attachmentspresent",
     "attachmentsexpected", "status", "reviewstate", "edits", "formversion", "instanceid", "instancename",
     "isvalidated"}
)  # fmt: skip
"""Columns that say something of the form, not of the place; others of them begin with `_` or `meta`."""


@dataclass(frozen=True, slots=True)
class SubmittedPhoto:
    """A photo that a table names."""

    name: str  # As written in the table
    submission: str | None  # Id of the submission, which may be part of the path of the file
    where: str  # File and row, for messages
    position: LatLon | None = None
    accuracy_m: float | None = None
    heading_deg: float | None = None
    taken_at: str | None = None  # ISO 8601, local time
    note: str | None = None


class _Place(NamedTuple):
    column: int
    position: LatLon
    accuracy_m: float | None


@dataclass(slots=True)
class _Table:
    """A table; its header in small letters is `names`."""

    where: str
    header: list[str]
    rows: list[list[str]]
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.names = [text.strip().lower() for text in self.header]

    def value(self, row: Sequence[str], name: str) -> str | None:
        """Return the value of a column; None if the table lacks it, or it is empty."""
        return row[self.names.index(name)].strip() or None if name in self.names else None

    def short_name(self, column: int) -> str:
        """Return the name of a question without its groups."""
        return re.split(r"[/:]|(?<=\w)-(?=\w)", self.names[column])[-1].strip()


def read_submissions(paths: Sequence[Path], *, folder: Path, all_answers: bool) -> list[SubmittedPhoto]:
    """Read the photos that tables name.

    Args:
        folder: What names of files are shown relative to.
        all_answers: Notes have all answers, not only the comments.

    Raises:
        InputError: A table is too large, or no table.
    """
    tables = [_read(path, where=path.relative_to(folder).as_posix()) for path in paths]
    parents = {
        key: (table, row) for table in tables for row in table.rows if (key := table.value(row, "key"))
    }
    return [photo for table in tables for photo in _photos(table, parents=parents, all_answers=all_answers)]


def _read(path: Path, *, where: str) -> _Table:
    data = path.read_bytes()
    if len(data) > _MOST_BYTES:
        raise InputError("the table is too large", where=where, hint="export fewer submissions")
    text = _decoded(data, where=where)
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count)
    csv.field_size_limit(_MOST_CELL)
    rows: list[list[str]] = []
    try:
        for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter):
            if len(row) > _MOST_COLUMNS or len(rows) > MOST_ROWS:
                raise InputError("the table is too large", where=where, hint="export fewer submissions")
            rows.append([cell_text(cell) for cell in row])
    except csv.Error as error:
        raise InputError(f"the table cannot be read: {error}", where=where, hint="export it again") from error
    header = rows[0] if rows else []
    width = len(header)
    return _Table(where, header, [[*row, *[""] * (width - len(row))][:width] for row in rows[1:] if any(row)])


def _decoded(data: bytes, *, where: str) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    if b"\0" in data[:4096]:
        raise InputError("this is not a table", where=where, hint="export it as CSV")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _photos(
    table: _Table, *, parents: Mapping[str, tuple[_Table, list[str]]], all_answers: bool
) -> Iterator[SubmittedPhoto]:
    columns = _photo_columns(table)
    for number, row in enumerate(table.rows, 2):
        named = [(column, row[column].strip()) for column in columns if _is_photo(row[column])]
        if not named:
            continue
        above = _above(table, row, parents)
        for column, name in named:
            lines = [(table, row), *above]
            place = next((found for one in lines if (found := _place(*one, column))), None)
            yield SubmittedPhoto(
                PurePosixPath(name.replace("\\", "/")).name,
                submission=_submission(lines),
                where=f"{table.where}, row {number}",
                position=None if place is None else place.position,
                accuracy_m=None if place is None else place.accuracy_m,
                taken_at=next((time for one in lines if (time := _time(*one))), None),
                note=_note(lines, all_answers=all_answers),
            )


def _above(
    table: _Table, row: Sequence[str], parents: Mapping[str, tuple[_Table, list[str]]]
) -> list[tuple[_Table, list[str]]]:
    """Return the rows that a row of a repeat belongs to, the nearest first."""
    found: list[tuple[_Table, list[str]]] = []
    key = table.value(row, "parent_key")
    while key is not None and key in parents and len(found) < 10:
        found.append(parents[key])
        key = found[-1][0].value(found[-1][1], "parent_key")
    return found


def _is_photo(value: str) -> bool:
    return "://" not in value and PurePosixPath(value.strip().lower()).suffix in PHOTO_SUFFIXES


def _photo_columns(table: _Table) -> list[int]:
    return [
        column for column in range(len(table.header)) if any(_is_photo(row[column]) for row in table.rows)
    ]


def _place(table: _Table, row: Sequence[str], column: int) -> _Place | None:
    """Return the position of the question next before that of the photo, else of the first one after it."""
    places = sorted([*_in_columns(table, row), *_in_one_column(table, row)])
    before = [place for place in places if place.column < column]
    return before[-1] if before else next(iter(places), None)


def _in_columns(table: _Table, row: Sequence[str]) -> Iterator[_Place]:
    for column, name in enumerate(table.names):
        found = _LATITUDE.fullmatch(name)
        if found is None:
            continue
        start = f"{found[1]}{found[2]}"
        others = [table.value(row, f"{start}{end}") for end in ("longitude", "lon", "lng", "long")]
        lon = next((value for value in others if value is not None), None)
        stated = [table.value(row, f"{start}{end}") for end in ("accuracy", "precision")]
        position = _position(row[column], lon or "")
        if position is not None:
            yield _Place(column, position, _metres(next((one for one in stated if one), "")))


def _in_one_column(table: _Table, row: Sequence[str]) -> Iterator[_Place]:
    for column, value in enumerate(row):
        found = _GEOPOINT.fullmatch(value.strip()) if len(value) < 200 else None
        position = None if found is None else _position(found[1], found[2])
        if found is not None and position is not None:
            rest = found[3].split()
            yield _Place(column, position, _metres(rest[1]) if len(rest) > 1 else None)


def _position(lat: str, lon: str) -> LatLon | None:
    try:
        at = LatLon(float(lat), float(lon))
    except ValueError:
        return None
    return at if abs(at.lat) <= 90.0 and abs(at.lon) <= 180.0 else None


def _metres(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0.0 < value < 1e6 else None


def _submission(lines: Sequence[tuple[_Table, Sequence[str]]]) -> str | None:
    """Return the id of the submission: that of the outermost row."""
    table, row = lines[-1]
    named = (table.value(row, name) for name in ("_uuid", "meta-instanceid", "instanceid", "key"))
    found = next((value for value in named if value), None)
    return None if found is None else found.removeprefix("uuid:")


def _time(table: _Table, row: Sequence[str]) -> str | None:
    for name in _TIMES:
        try:
            at = datetime.fromisoformat(table.value(row, name) or "")
        except ValueError:
            continue
        return at.replace(tzinfo=None).isoformat(timespec="seconds")
    return None


def _note(lines: Sequence[tuple[_Table, Sequence[str]]], *, all_answers: bool) -> str | None:
    said: list[str] = []
    for table, row in lines:
        for column, value in enumerate(row):
            text = _plain(value[: NOTE_TEXT.most])
            if not text or not _is_answer(table, column, value):
                continue
            is_comment = table.short_name(column) in NOTES
            if is_comment and not all_answers:
                said.append(text)
            elif all_answers:
                said.append(f"{table.header[column].strip()}: {text}")
    return "\n".join(said)[: NOTE_TEXT.most] or None


def _is_answer(table: _Table, column: int, value: str) -> bool:
    name = table.names[column]
    if name in _OF_THE_FORM or name.startswith(("_", "meta")) or table.short_name(column) in _OF_THE_FORM:
        return False
    is_place = re.fullmatch(r".*(latitude|longitude|altitude|accuracy|precision)", name)
    return not (is_place or _is_photo(value) or _GEOPOINT.fullmatch(value.strip()) or name.endswith("_url"))


def _plain(text: str) -> str:
    lines = text.replace("\r\n", "\n").replace("\r", "\n").strip()
    return "".join(c for c in lines if not has_controls(c, besides="\n\t"))
