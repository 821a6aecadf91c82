"""The text of a table: its header, its columns, and its cells as numbers, times and angles."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from webapp.core.column_words import DATE_ORDERS, EXCEL_DAYS
from webapp.core.columns import POSE_FIELDS, Columns, guess_columns, parse_columns, unit_word
from webapp.errors import TrackError, UsageError
from webapp.files.exchange.cells import angle, day_order, moment, quantity, split_datetime
from webapp.files.exchange.times import unix_time
from webapp.files.text_file import MAX_LINE, cell_text, delimiter_of, numbered_lines, split_row
from webapp.missions.core.trajectory.records import SOURCES, Source
from webapp.missions.files.readers.number_marks import NumberMarks, find_marks
from webapp.missions.files.readers.table_times import choose_times, plain_moment
from webapp.missions.files.readers.time_units import LAST_S, ticks
from webapp.missions.files.track_chunks import Findings

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


@dataclass(frozen=True, slots=True)
class Table:
    """Layout of a table, by which its cells are parsed."""

    columns: Columns
    delimiter: str
    skip: int  # Number of the last line of the header and the comments before the rows
    order: str = ""  # "ymd", "dmy", "mdy" or "". Order of day, month and year in dates; empty if unknown.
    header: tuple[str, ...] = ()  # Empty if there is none
    marks: NumberMarks = field(default_factory=NumberMarks)
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
        text, day = (plain_moment(self.text(fields, name)) for name in ("time", "date"))
        value = unix_time(text)
        if math.isnan(value) and day:
            value = unix_time(day) if ":" in day else moment(day, text, order=self.order)
            if math.isnan(value) and ":" in day:
                value = moment(*split_datetime(day), order=self.order)
        elif math.isnan(value) and text:
            value = self.seconds(text)
            if math.isnan(value):
                value = moment(*split_datetime(text), order=self.order)
        return value if abs(value) < LAST_S else math.nan

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
    chosen, said = choose_times(table.header, table.columns, rows=rows)
    return replace(table, columns=chosen, remarks=(*table.remarks, *said))


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
    marks = find_marks(rows, angles=("lat", "lon"), usual="." if table.delimiter == "," else ",")
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
    column = table.columns.get("time") or table.columns["date"]
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
