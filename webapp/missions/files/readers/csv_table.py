"""The text of a table: its header, its columns, and its cells as numbers, times and angles.

Absolute times come before relative ones, and UTC before local time. Decimal commas and thousands points are
decided by whole columns: `1.234` is 1.234 or 1234, and other cells of its column show which, such as
`1.200,5` or `12,5`, or else the other columns do. Latitudes and longitudes have no thousands: each mark in
them is a decimal one.
"""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from webapp.core.columns import (
    DATE_ORDERS,
    EXCEL_DAYS,
    POSE_FIELDS,
    Column,
    Columns,
    candidates,
    guess_columns,
    parse_columns,
    read_header,
    unit_word,
)
from webapp.errors import TrackError, UsageError
from webapp.files.exchange.cells import angle, day_order, moment, quantity, seconds_of_day, split_datetime
from webapp.files.exchange.times import unix_time
from webapp.files.text_file import MAX_LINE, cell_text, delimiter_of, numbered_lines, split_row
from webapp.missions.core.trajectory.records import SOURCES, Source
from webapp.missions.files.readers.time_units import LAST_S, WEEK_S, ticks, utc_from_week
from webapp.missions.files.track_chunks import Findings

_BLANK = "'’ \u00a0\u2009\u202f"
_NUMBER = re.compile(rf"[+-]?(\d[\d.,{_BLANK}]*)[^\d]*")
_GROUPS = re.compile(r"[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*")
_BLANKS = re.compile(rf"(?<=\d)[{_BLANK}](?=\d{{3}}(?:\D|$))")
_DECIMAL = re.compile(r"\d([.,])\d")
_OTHER = {".": ",", ",": "."}

_HEMISPHERES = {"lat": "NS", "lon": "EW"}
_EXCEL_EPOCH_S = -2_209_161_600.0
"""1899-12-30, the epoch of days in spreadsheets."""

_DEGREES = re.compile(r"\s*deg(?:rees?)?\b\.?", re.IGNORECASE)
_SEPARATOR = re.compile(r"\"?sep=(.)\"?", re.IGNORECASE)
_FIRST_S = 1e8
"""1973: frame numbers below this, as nanoseconds, are not times."""
_NANO = 1e-9
_SHOWN = 5
_TRIED = 200
"""Number of rows by which the column of the times is chosen."""

_MOST_IN_COMMENTS = MAX_LINE
"""Characters of the last comments before the rows in which the header is looked for."""

Key = tuple[Source, str]

_ABSOLUTE_S = 1e8
"""1973: smaller numbers count from another moment, such as the start of the recording."""

_MOST_CANDIDATES = 20
"""Number of columns for times that are compared."""

_IN_MILLISECONDS = {"gms", "itow", "i_tow"}
"""Headers of seconds of the week in milliseconds, as u-blox and ArduPilot name them."""

_WEEKS_OF_10_BITS = 1024
_WEEK_OF_GPS = re.compile(r"gps|\bgwk|\bwn", re.IGNORECASE)
"""In headers of weeks that are not those of a calendar."""

_NO_DEGREES = 360.0
_EXIF_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d)(?=[ T]|$)")


@dataclass(slots=True)
class _Seen:
    """What the cells of a column show: a cell for each mark."""

    decimal: dict[str, str] = field(default_factory=dict)
    thousands: dict[str, str] = field(default_factory=dict)
    unsure: dict[str, str] = field(default_factory=dict)

    def add(self, text: str, *, is_angle: bool) -> None:
        if is_angle:
            for mark in _DECIMAL.findall(text):
                self.decimal.setdefault(mark, text)
            return
        found = _NUMBER.fullmatch(text)
        if found is None:
            return
        digits = _BLANKS.sub("", found[1]).rstrip(f".,{_BLANK}")
        marks = [one for one in digits if one in _OTHER]
        if len(set(marks)) == 2 and marks.count(marks[-1]) == 1:
            self.decimal.setdefault(marks[-1], text)
            self.thousands.setdefault(marks[0], text)
        elif len(marks) == 1 and not _GROUPS.fullmatch(digits):
            self.decimal.setdefault(marks[0], text)
        elif len(marks) == 1:
            self.unsure.setdefault(marks[0], text)
        elif marks and _GROUPS.fullmatch(digits):
            self.thousands.setdefault(marks[0], text)

    @property
    def sure(self) -> set[str]:
        """The decimal marks that the column shows: none, one, or both if it contradicts itself."""
        return {*self.decimal, *(_OTHER[mark] for mark in self.thousands)}


@dataclass(frozen=True, slots=True)
class _NumberMarks:
    """The decimal mark of each column, by field; the other one separates thousands."""

    decimal: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # What was decided, for people

    def plain(self, text: str, name: str) -> str:
        """Write the numbers of a cell with decimal points and without thousands."""
        mark = self.decimal.get(name)
        if mark is None:
            return text.replace(",", ".") if "," in text and "." not in text else text
        if not text.isascii() or " " in text or "'" in text:
            text = _BLANKS.sub("", text)
        return text.replace(_OTHER[mark], "").replace(mark, ".")


def _find_marks(rows: Iterable[Mapping[str, str]], *, angles: Sequence[str], usual: str) -> _NumberMarks:
    """Decide on the marks of all columns.

    Args:
        rows: The cells of each row that hold numbers, by field.
        angles: Fields of latitudes and longitudes.
        usual: What a comma is where no cell shows it: "," for decimal, "." for one that separates thousands.
    """
    seen: dict[str, _Seen] = {}
    for row in rows:
        for name, text in row.items():
            if "." in text or "," in text:
                seen.setdefault(name, _Seen()).add(text, is_angle=name in angles)
    sure = {mark for one in seen.values() for mark in one.sure}
    decimal: dict[str, str] = {}
    notes: list[str] = []
    for name, one in seen.items():
        if len(one.sure) == 2:
            notes.append(f"{name} has decimal points and decimal commas: both are taken as decimal")
            continue
        if one.sure:
            (decimal[name],) = one.sure
        elif one.unsure:
            decimal[name] = next(iter(sure)) if len(sure) == 1 else "," if "," in one.unsure else "."
            if not sure and decimal[name] == ",":
                decimal[name] = usual
    return _NumberMarks(decimal, (*notes, *_mark_notes(seen, decimal)))


def _mark_notes(seen: Mapping[str, _Seen], decimal: Mapping[str, str]) -> list[str]:
    known = _NumberMarks(decimal)
    notes = []
    for name, mark in decimal.items():
        grouped = seen[name].thousands.get(_OTHER[mark]) or seen[name].unsure.get(_OTHER[mark])
        if grouped:
            kind = "points" if mark == "," else "commas"
            value = known.plain(grouped, name)
            notes.append(f"{kind} in {name} separate thousands: {grouped} was read as {value}")
    commas = ((name, {**seen[name].unsure, **seen[name].decimal}.get(",")) for name in decimal)
    shown = next(((name, text) for name, text in commas if text and decimal[name] == ","), None)
    if shown is not None:
        notes.append(f"commas are decimal: {shown[1]} was read as {known.plain(shown[1], shown[0])}")
    return notes


@dataclass(frozen=True, slots=True)
class Table:
    """Layout of a table, by which its cells are parsed."""

    columns: Columns
    delimiter: str
    skip: int  # Number of the last line of the header and the comments before the rows
    order: str = ""  # "ymd", "dmy", "mdy" or "". Order of day, month and year in dates; empty if unknown.
    header: tuple[str, ...] = ()  # Empty if there is none
    marks: _NumberMarks = field(default_factory=_NumberMarks)
    remarks: tuple[str, ...] = ()  # How the columns were understood

    def text(self, fields: Sequence[str], name: str) -> str:
        """Return the text of a field; empty if the row or the table lacks it."""
        column = self.columns.get(name)
        return cell_text(fields[column.index].strip()) if column and column.index < len(fields) else ""

    def number(self, fields: Sequence[str], name: str) -> float:
        """Return a field as a number in its standard unit; NaN if it is not a number."""
        if name == "time":
            return self.time(fields)
        text = self.text(fields, name)
        if not text:
            return math.nan
        text = self.marks.plain(text, name)
        scale = self.columns[name].scale
        if name in _HEMISPHERES:
            text = _DEGREES.sub("°", text) if "e" in text else text
            value = self.signed(angle(text, scale=scale, hemispheres=_HEMISPHERES[name]), fields, name=name)
        else:
            value = _quantity(text, scale=scale, field=name)
        return value if math.isfinite(value) else math.nan

    def signed(self, value: float, fields: Sequence[str], *, name: str) -> float:
        """Apply the sign of the hemisphere from a separate column, or from an unnamed one after the angle."""
        letter = self.text(fields, f"{name}_ref")[:1].upper()
        after = self.columns[name].index + 1
        if not letter and after < min(len(self.header), len(fields)) and not self.header[after].strip():
            letter = fields[after].strip().upper()
        if letter and letter in _HEMISPHERES[name]:
            return math.copysign(value, -1.0 if letter in "SW" else 1.0)
        return value

    def time(self, fields: Sequence[str]) -> float:
        """Return the time of a row, combining a date and a time column if necessary; NaN without a time."""
        if "week" in self.columns:
            week, seconds = (self.number(fields, name) for name in ("week", "tow"))
            return utc_from_week(week, seconds) if week >= 0.0 and 0.0 <= seconds <= WEEK_S else math.nan
        later = self.number(fields, "nanos") if "nanos" in self.columns else 0.0
        value = self._moment(fields) + later
        return value if abs(value) < LAST_S else math.nan

    def _moment(self, fields: Sequence[str]) -> float:
        text, day = (_plain_moment(self.text(fields, name)) for name in ("time", "date"))
        value = unix_time(text)
        if math.isnan(value) and day:
            value = unix_time(day) if ":" in day else moment(day, text, order=self.order)
            if math.isnan(value) and ":" in day:
                value = moment(*split_datetime(day), order=self.order)
        elif math.isnan(value) and text:
            value = self.seconds(text)
            if math.isnan(value):
                value = moment(*split_datetime(text), order=self.order)
        return value

    def seconds(self, text: str) -> float:
        """Parse a numeric time; return seconds since 1970."""
        column = self.columns["time"]
        value = _quantity(self.marks.plain(text, "time"), scale=column.scale, field="time")
        if column.scale == EXCEL_DAYS:
            return _EXCEL_EPOCH_S + value
        if self.has_frame_numbers and value * _NANO < _FIRST_S:
            return math.nan
        return value / ticks(value) if column.scale == 1.0 else value

    @property
    def has_times(self) -> bool:
        return any(name in self.columns for name in ("time", "date", "week"))

    @property
    def has_frame_numbers(self) -> bool:
        """Whether the time column holds frame ids, which are timestamps in some datasets."""
        index = self.columns["time"].index
        return index < len(self.header) and "frame_id" in self.header[index].lower()

    def _source(self, fields: Sequence[str]) -> Source:
        given = self.text(fields, "source").lower()
        usual: Source = "gps" if "lat" in self.columns else "odometry"
        return next((source for source in SOURCES if source == given), usual)

    def key(self, fields: Sequence[str]) -> Key:
        """Return the track of a row."""
        return self._source(fields), self.text(fields, "track")


def open_table(file: BinaryIO, columns: str | None) -> Table:
    """Find the header, which may be a comment, and the meaning of the columns.

    Raises:
        TrackError: The table is empty, or its columns are not recognized.
        UsageError: `columns` does not fit the table.
    """
    remarks: deque[str] = deque()
    characters = 0
    given = ""
    first: tuple[int, str] | None = None
    for number, line in numbered_lines(file):
        separator = _SEPARATOR.fullmatch(line)
        if separator is not None and not given:  # Excel's own line
            given = separator[1]
        elif line.lstrip().startswith("#"):
            remarks.appendleft(line.strip().lstrip("#").strip())
            characters += len(remarks[0]) + 1
            while characters > _MOST_IN_COMMENTS:
                characters -= len(remarks.pop()) + 1
        elif line.strip():
            first = (number, line)
            break
    if first is None:
        raise TrackError("the table is empty")
    number, line = first
    delimiter = given or delimiter_of(line) or ","
    table = _open(line, remarks, columns, number=number, delimiter=delimiter)
    if columns:
        return table
    rows = [cells for _, cells in islice(table_rows(file, table), _TRIED)]
    _check_degrees(table, rows)
    chosen, said = _choose_times(table.header, table.columns, rows=rows)
    if {"week", "tow"} & chosen.keys():
        chosen, said = _choose_weeks(table.header, chosen, rows=rows, said=said)
    return replace(table, columns=chosen, remarks=(*table.remarks, *said))


def _check_degrees(table: Table, rows: Sequence[Sequence[str]]) -> None:
    """Refuse latitudes in another unit than their header says, such as 1e-7 degrees. Raises TrackError."""
    found = [abs(table.number(row, "lat")) for row in rows] if "lat" in table.columns else []
    known = [value for value in found if not math.isnan(value)]
    if known and min(known) > _NO_DEGREES:
        name = table.header[table.columns["lat"].index].strip()
        raise TrackError(
            f"the numbers of {name!r}, such as {known[0]:.10g}, are no degrees",
            hint="give their unit, such as lat=lat:e7, lon=lon:e7; or convert them to degrees",
        )


def _open(line: str, remarks: Iterable[str], columns: str | None, *, number: int, delimiter: str) -> Table:
    header = split_row(line, delimiter)
    if columns:
        return _with_columns(columns, header, remarks, number=number, delimiter=delimiter)
    try:
        return _guessed(header, number, delimiter)
    except TrackError:
        for remark in remarks:
            named = split_row(remark.rpartition(": ")[2], delimiter_of(remark) or ",")
            try:
                return _guessed(named, number - 1, delimiter)
            except TrackError:
                continue
        raise


def _guessed(header: list[str], skip: int, delimiter: str) -> Table:
    remarks: list[str] = []
    columns = guess_columns(header, remarks=remarks)
    return Table(columns, delimiter, skip, header=tuple(header), remarks=tuple(remarks))


def with_marks(file: BinaryIO, table: Table) -> Table:
    """Decide on the decimal marks by all rows; they are points where no cell can have a comma."""
    file.seek(0)
    if table.delimiter == "," and not any('"' in line for _, line in numbered_lines(file)):
        return table
    names = [name for name in table.columns if any(POSE_FIELDS.units[name])]
    rows = ({name: table.text(cells, name) for name in names} for _, cells in table_rows(file, table))
    marks = _find_marks(rows, angles=("lat", "lon"), usual="." if table.delimiter == "," else ",")
    return replace(table, marks=marks, remarks=(*table.remarks, *marks.notes))


def _with_columns(
    columns: str, header: list[str], remarks: Iterable[str], *, number: int, delimiter: str
) -> Table:
    """Apply a given column specification; the first line may be a header or a row."""
    table = Table({}, delimiter, number)
    for remark in remarks:
        named = split_row(remark.rpartition(": ")[2], delimiter_of(remark) or ",")
        if len(named) == len(header):
            try:
                return replace(
                    table, columns=parse_columns(columns, named), skip=number - 1, header=tuple(named)
                )
            except UsageError:
                continue
    table = replace(table, columns=parse_columns(columns, header), header=tuple(header))
    place = ("lat", "lon") if "lat" in table.columns else ("x", "y")
    is_data = all(not math.isnan(table.number(header, name)) for name in place)
    return replace(table, skip=number - 1, header=()) if is_data else table


@dataclass(frozen=True, slots=True)
class TableHead:
    """The beginning of a table, for display."""

    header: tuple[str, ...]  # Empty if there is none
    rows: tuple[tuple[str, ...], ...]  # The first rows
    columns: dict[str, int]  # Index of the column of each field, from 0
    units: dict[str, str]  # Units of the fields that have one
    problem: str = ""  # Why the columns are not recognised; empty if they are

    def named(self) -> list[str]:
        """Return the column specification, in the format of the option `--columns`."""
        header = self.header
        return [f"{field}={header[at] if at < len(header) else at + 1}" for field, at in self.columns.items()]


def table_head(path: Path, columns: str | None) -> TableHead:
    """Read the beginning of a table; raise as `open_table`, except for unrecognised columns."""
    with path.open("rb") as file:
        problem = ""
        try:
            table = open_table(file, columns)
        except TrackError as error:
            file.seek(0)
            lines = (line for _, line in numbered_lines(file) if line.strip())
            first = next(lines, None)
            if first is None:
                raise
            problem = str(error)
            separator = _SEPARATOR.fullmatch(first)
            delimiter = separator[1] if separator else delimiter_of(first) or ","
            table = Table({}, delimiter, int(separator is not None))
        rows = tuple(tuple(cells) for _, cells in islice(table_rows(file, table), _SHOWN))
        if problem and rows:
            table, rows = replace(table, header=rows[0]), rows[1:]
    places = {name: column.index for name, column in table.columns.items()}
    units = {name: unit for name, column in table.columns.items() if (unit := _unit(name, column.scale))}
    return TableHead(table.header, rows, places, units, problem)


def _unit(field: str, scale: float) -> str:
    """Return the name of the unit of a field with this scale; empty without units."""
    return next((unit for unit, known in POSE_FIELDS.units[field].items() if known == scale), "")


def table_rows(file: BinaryIO, table: Table) -> Iterator[tuple[str, list[str]]]:
    """Yield each row: its line number as text for messages, and its cells."""
    file.seek(0)
    for number, line in numbered_lines(file):
        if number > table.skip and line.strip() and not line.lstrip().startswith("#"):
            yield f"line {number}", split_row(line, table.delimiter)


def time_name(table: Table) -> str:
    """Return the name of the time column from the header, or else its number."""
    column = next(table.columns[name] for name in ("tow", "time", "date") if name in table.columns)
    return table.header[column.index].strip() if column.index < len(table.header) else str(column.index + 1)


def date_order(file: BinaryIO, table: Table, *, findings: Findings) -> str:
    """Detect whether the day or the month comes first in dates."""
    column = table.columns.get("date") or table.columns.get("time")
    if column is None:
        return ""
    given = next((name for name, scale in DATE_ORDERS.items() if scale == column.scale), "")
    if "date" in table.columns and given:
        return given
    name = "date" if "date" in table.columns else "time"
    unsure = ""
    for _, fields in table_rows(file, table):
        day = split_datetime(table.text(fields, name))[0]
        order = day_order(day)
        if order in ("dmy", "mdy"):
            return order
        if order is None and day:
            if len(day) == 6 and day.isdecimal() and name == "date":
                findings.note(
                    f"dates such as {day} were read with the year first (set date={name}:dmy if not)"
                )
            return ""
        unsure = unsure or day
    if unsure:
        findings.note(
            f"dates such as {unsure} may begin with the day or with the month: no times were taken "
            "(set date=COLUMN:dmy or date=COLUMN:mdy)"
        )
    return ""


def _quantity(text: str, *, scale: float, field: str) -> float:
    """Parse a number that may be followed by a unit of its own, which may be spelled out."""
    number, blank, unit = text.partition(" ")
    text = f"{number} {unit_word(unit)}" if blank and unit.strip() else text
    return quantity(text, scale=scale, units=POSE_FIELDS.units[field])


class _Holds(IntEnum):
    """What a column holds, the best last."""

    NOTHING = 0
    RELATIVE = 1
    CLOCK = 2  # Times of day, for which another column has the date
    MOMENTS = 3


@dataclass(frozen=True, slots=True)
class _Candidate:
    column: Column
    basis: int  # 1 for UTC, 0 for unknown, -1 for local time
    holds: _Holds

    @property
    def rank(self) -> tuple[bool, int, int, int]:
        return self.holds >= _Holds.CLOCK, self.basis, self.holds, -self.column.index


def _choose_times(
    header: Sequence[str], columns: Columns, *, rows: Sequence[Sequence[str]]
) -> tuple[Columns, list[str]]:
    """Choose among several columns for times and dates.

    Args:
        columns: As guessed from the header alone.
        rows: The first rows.

    Returns:
        columns: With the chosen ones as `time` and `date`.
        remarks: Sentences on the choice, if there was one.
    """
    dates = candidates(header, "date")
    times = [
        _Candidate(column, basis, _holds(column, rows, has_date=bool(dates)))
        for column, basis in candidates(header, "time")[:_MOST_CANDIDATES]
    ]
    if not times:
        return columns, []
    best = max(times, key=lambda one: one.rank)
    chosen = {**columns, "time": best.column}
    remarks = []
    if best.holds is _Holds.MOMENTS:
        chosen.pop("date", None)
    elif dates:
        chosen["date"] = min(dates, key=lambda one: abs(one[1] - best.basis))[0]
    names = [header[one.column.index].strip() for one in times if one.holds > _Holds.NOTHING]
    name = header[best.column.index].strip()
    if len(names) > 1:
        others = ", ".join(one for one in names if one != name)
        remarks.append(f"the times are read from the column {name}, not from {others}")
    if best.holds is not _Holds.NOTHING and best.basis < 0:
        remarks.append(f"the local times of {name} were read as UTC")
    return chosen, remarks


def _choose_weeks(
    header: Sequence[str], columns: Columns, *, rows: Sequence[Sequence[str]], said: list[str]
) -> tuple[Columns, list[str]]:
    """Decide whether the times are weeks of GPS and seconds of the week; arguments as `_choose_times`."""
    others = {name: column for name, column in columns.items() if name not in ("week", "tow")}
    time, week, tow = (columns.get(name) for name in ("time", "week", "tow"))
    holds = _Holds.NOTHING if time is None else _holds(time, rows, has_date="date" in columns)
    is_local = time is not None and read_header(header[time.index]).basis < 0
    if holds >= _Holds.CLOCK and not (is_local and week and tow):
        return others, said
    number = _largest(rows, week) if week else 0.0
    if tow is None and week and number < _WEEKS_OF_10_BITS and not _WEEK_OF_GPS.search(header[week.index]):
        return others, said
    if tow is None and holds is _Holds.RELATIVE:
        tow = time
    if week is None and tow is not None:
        if holds is not _Holds.NOTHING:
            return others, said
        note = (
            f"the seconds of a week in {header[tow.index].strip()} have no week: they count from 1970-01-01"
        )
        return {**others, "time": tow}, [note]
    if week is None or tow is None:
        note = "the weeks of GPS are not used: no column has the seconds of the week"
        return others, [*said, note]
    name = header[tow.index].strip()
    if read_header(name).unit is None and (_largest(rows, tow) > WEEK_S or name.lower() in _IN_MILLISECONDS):
        tow = replace(tow, scale=1e-3)
    notes = [f"the times are weeks of GPS and seconds of the week in {name}: they were converted to UTC"]
    if number < _WEEKS_OF_10_BITS:
        notes.append(f"week {number:.0f} is one of 1980 to 1999: some receivers begin again after 1024 weeks")
    rest = {name: column for name, column in others.items() if name not in ("time", "date")}
    return {**rest, "week": week, "tow": tow}, notes


def _largest(rows: Sequence[Sequence[str]], column: Column) -> float:
    cells = [row[column.index].strip().replace(",", ".") for row in rows if column.index < len(row)]
    numbers = [quantity(cell, scale=1.0, units={}) for cell in cells]
    return max((number for number in numbers if not math.isnan(number)), default=0.0)


def _plain_moment(text: str) -> str:
    """Write the date of a time as in Exif, `2026:05:01 10:00:00`, with hyphens."""
    return _EXIF_DATE.sub(r"\1-\2-\3", text, count=1) if text[4:5] == ":" else text


def _holds(column: Column, rows: Sequence[Sequence[str]], *, has_date: bool) -> _Holds:
    cells = [row[column.index].strip().lstrip("'") for row in rows if column.index < len(row)]
    found = Counter(_kind(cell, column.scale, has_date=has_date) for cell in cells if cell)
    return max(found, key=lambda one: (found[one], one), default=_Holds.NOTHING)


def _kind(cell: str, scale: float, *, has_date: bool) -> _Holds:
    cell = _plain_moment(cell)
    if not math.isnan(unix_time(cell)):
        return _Holds.MOMENTS
    if any(not math.isnan(moment(*split_datetime(cell), order=order)) for order in ("dmy", "mdy")):
        return _Holds.MOMENTS
    if not math.isnan(seconds_of_day(cell, packed=has_date and scale == 1.0)):
        return _Holds.CLOCK if has_date else _Holds.NOTHING
    number, _, unit = cell.replace(",", ".").partition(" ")
    value = quantity(number, scale=scale, units={}) if not unit or unit_word(unit) else math.nan
    if math.isnan(value):
        return _Holds.NOTHING
    value = value / ticks(value) if scale == 1.0 else value
    return _Holds.MOMENTS if abs(value) >= _ABSOLUTE_S else _Holds.RELATIVE
