"""Meaning of a table's columns: given by the user, or guessed from its header.

Written as `time=stamp:ms, lat=Latitude, lon=Longitude, heading=yaw:rad`: a field, the column by its header or
by its number from 1, and a unit if it is neither in the header nor the default. A unit that is not known is
refused, never replaced by the default.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from webapp.core.column_words import (
    LOCAL_WORDS,
    NAMES,
    NEEDED,
    PHOTO_NAMES,
    PHOTO_UNITS,
    QUALIFIERS,
    UNIT_WORDS,
    UNITS,
    UTC_WORDS,
)
from webapp.errors import TrackError, UsageError


@dataclass(frozen=True, slots=True)
class ColumnFields:
    """The fields of a kind of table."""

    units: Mapping[str, Mapping[str, float]]  # The units of each field
    # Headers by which each field is recognised: lower case, words joined by `_`.
    names: Mapping[str, Sequence[str]]
    needed: tuple[str, ...]  # Fields that are required in addition to a position
    example: str  # Example of how columns are written
    by_name: Mapping[str, str] = field(init=False, repr=False)  # The field of each header

    def __post_init__(self) -> None:
        known = ((word, name) for name, words in reversed(list(self.names.items())) for word in words)
        object.__setattr__(self, "by_name", dict(known))


POSE_FIELDS = ColumnFields(UNITS, NAMES, (), "time=stamp:ms, lat=Latitude, lon=Longitude")
"""Poses and objects of a mission."""

PHOTO_FIELDS = ColumnFields(PHOTO_UNITS, PHOTO_NAMES, ("name",), "name=File, lat=Latitude, lon=Longitude")
"""Positions of photos, on the Earth or in pixels of the satellite image."""

_PART = re.compile(r"\s*([a-z_]+)\s*=\s*(.+?)\s*(?::\s*([a-z0-9%]+)\s*)?", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"(.+?)[\s_]*[\[({]([^\[\](){}]*)[\])}]\s*")
_AFTER_SLASH = re.compile(r"(.+?)\s*/\s*([^/]+)")
_AFTER_WORD = re.compile(
    r"(.+?)[_\s](s|sec|seconds|ms|msec|millis|milliseconds|us|usec|micros|microseconds|ns|nsec|nanos|nanoseconds|"
    r"m|m2|mm|cm|km|ft|feet|yd|metres|meters|deg|degrees|rad|radians|mrad|e7|e6|px)"
)
"""A unit after a name; those that are words themselves (`min`, `in`) only count in brackets."""

_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")

LONGEST_HEADER = 100
"""Characters; a longer cell is no header, and taking it apart could take quadratic time."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    index: int  # From 0
    scale: float  # Factor that converts its numbers to the field's default unit


Columns = Mapping[str, Column]


def parse_columns(text: str, header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS) -> Columns:
    """Parse the user's assignment of columns to fields.

    Args:
        text: Fields separated by commas, as described above.
        header: The table's first line; names are compared without regard to case.
        fields: Fields that the table can have.

    Raises:
        UsageError: A field, a unit or a column is unknown, or positions are missing.
    """
    names = [name.strip().lstrip("#%").strip().lower() for name in header]
    found: dict[str, Column] = {}
    for part in text.split(","):
        written = _PART.fullmatch(part)
        field = written[1].lower() if written else ""
        if written is None or field not in fields.units:
            hint = f"write it like {fields.example}; fields are {', '.join(fields.units)}"
            raise UsageError(
                f"{part.strip()[:60]!r} is not a field of this table", where="columns", hint=hint
            )
        name, unit = written[2], written[3]
        index = _place(name, names)
        if index is None and unit is not None:  # the header itself contains the colon
            index, unit = _place(f"{name}:{unit}", names), None
        if index is None:
            hint = f"its columns are {', '.join(header)[:200]}; numbers count from 1"
            raise UsageError(f"the table has no column {name[:40]!r}", where="columns", hint=hint)
        units = fields.units[field]
        unit = _stated(header[index], units) if unit is None else unit
        found[field] = Column(index, _scale(field, unit, units=units))
    problem = _missing(found, fields)
    if 0 < sum(f"q{axis}" in found for axis in "xyzw") < len("xyzw"):
        problem = "the quaternion is incomplete"
    if ("week" in found) != ("tow" in found):
        problem = "a time of GPS needs both week and tow, the seconds of the week"
    if problem:
        raise UsageError(problem, where="columns", hint=f"write them like {fields.example}")
    return found


class Header(NamedTuple):
    """A header, taken apart."""

    field: str | None  # None if it is not recognised
    unit: str | None  # As written; None without one
    basis: int  # Of a time: 1 for UTC, -1 for a local time, 0 if it does not say


def read_header(name: str, *, fields: ColumnFields = POSE_FIELDS) -> Header:
    """Recognise a field and a unit: `timestamp_ms`, `Latitude [deg]`, `Höhe (m)`, `timeNanos` ..."""
    found = _read_plain(_header(name), fields)
    return found if found.field else _read_plain(_header(_CAMEL.sub("_", name)), fields)


def _read_plain(plain: str, fields: ColumnFields) -> Header:
    plain = plain.removeprefix("field.")  # as `rostopic echo -p` writes
    words = set(re.findall(r"[a-z]+", plain))
    basis = 1 if words & UTC_WORDS else -1 if words & LOCAL_WORDS else 0
    whole = _recognized(plain, fields)
    if whole is not None:
        return Header(whole, None, basis)
    for pattern in (_IN_BRACKETS, _AFTER_SLASH, _AFTER_WORD):
        parts = pattern.fullmatch(plain)
        if parts is None:
            continue
        unit = parts[2].strip() if _spelled(parts[2]) else None
        field = _recognized(parts[1], fields)
        if field is None and pattern is _IN_BRACKETS:  # `time_utc (ms)` or `timestamp_ms (UTC)`
            inner = _read_plain(parts[1], fields)
            field, unit = inner.field, unit or inner.unit
        if field is not None:
            return Header(field, unit, basis)
    return Header(None, None, basis)


def is_header(cell: str) -> bool:
    """Return whether a cell is a known header of some table."""
    return any(read_header(cell, fields=fields).field for fields in (POSE_FIELDS, PHOTO_FIELDS))


def guess_columns(
    header: Sequence[str], *, fields: ColumnFields = POSE_FIELDS, remarks: list[str] | None = None
) -> Columns:
    """Guess the columns' fields from the header; of several of a field the first is taken.

    Args:
        remarks: Gets a sentence on each column that is left out because its unit is not known.

    Raises:
        TrackError: No columns for a position or another required field are recognised, or a time or a
            position has an unknown unit.
    """
    found: dict[str, Column] = {}
    unknown: dict[str, tuple[str, str]] = {}
    for index, name in enumerate(header):
        field, unit, _ = read_header(name, fields=fields)
        if field is None or field in found:
            continue
        units = fields.units[field]
        scale = _known_scale(unit, units)
        if scale is None:
            unknown.setdefault(field, (name.strip(), str(unit)))
        else:
            found[field] = Column(index, scale)
    for pair in (("lat", "lon"), ("x", "y")):
        if len(found.keys() & {"lat", "lon", "x", "y"}) == 3 and len(found.keys() & set(pair)) == 1:
            found = {field: column for field, column in found.items() if field not in pair}
    for field, (name, unit) in unknown.items():
        if field in found:
            continue
        if field in NEEDED:
            raise TrackError(
                f"the unit {unit[:40]!r} of the column {name[:60]!r} is not known",
                hint=f"convert it, or give the columns with one of {', '.join(fields.units[field])}",
            )
        if remarks is not None:
            remarks.append(f"the column {name[:60]!r} is left out, as its unit {unit[:40]!r} is not known")
    if _missing(found, fields):
        hint = f"assign columns to fields, such as {fields.example}"
        what = " and ".join((*(f"{field}s" for field in fields.needed), "positions"))
        raise TrackError(f"no columns of {what} are recognised in {', '.join(header)[:100]!r}", hint=hint)
    return found


def candidates(
    header: Sequence[str], field: str, *, fields: ColumnFields = POSE_FIELDS
) -> list[tuple[Column, int]]:
    """Return every column of a field whose unit is known, each with its basis (see `Header`)."""
    read = [read_header(name, fields=fields) for name in header]
    scales = [_known_scale(one.unit, fields.units[field]) if one.field == field else None for one in read]
    return [(Column(n, s), read[n].basis) for n, s in enumerate(scales) if s is not None]


def unit_word(text: str) -> str:
    """Return the name of a unit that may be spelled out: `ms` for `milliseconds`."""
    word = _spelled(text)
    return UNIT_WORDS.get(word, word)


def _spelled(text: str) -> str:
    """Join the words of a unit, without those that are no part of it: `m` of `m above sea level`."""
    words = re.split(r"[\s,;_]+|(?<=[a-z])-(?=[a-z])", text.strip().rstrip("."))
    return "_".join(word for word in words if word and word not in QUALIFIERS)


def _plain(text: str) -> str:
    """Return a header in lower case without accents and marks of comments."""
    parts = unicodedata.normalize("NFKD", text.strip().lstrip("#%").strip().lower().replace("º", "°"))
    plain = "".join(one for one in parts if not unicodedata.combining(one))
    return plain.replace("ß", "ss").replace("ł", "l")


def _header(cell: str) -> str:
    """Return a cell as `_plain` does; empty if it is too long for a header."""
    plain = _plain(cell) if len(cell.strip()) <= LONGEST_HEADER else ""
    return plain if len(plain) <= LONGEST_HEADER else ""


def _words(text: str) -> str:
    return re.sub(r"[\s._\-]+", "_", text.strip()).strip("_")


def _recognized(name: str, fields: ColumnFields) -> str | None:
    return fields.by_name.get(_words(name))


def _known_scale(unit: str | None, units: Mapping[str, float]) -> float | None:
    """Return the scale of a unit; the default's without one, and for texts. None if it is not known."""
    if unit is None or not any(units):
        return next(iter(units.values()))
    return units.get(unit_word(unit))


def _stated(name: str, units: Mapping[str, float]) -> str | None:
    """Return the unit that the header of a given column states, if any."""
    plain = _header(name)
    in_brackets, after = _IN_BRACKETS.fullmatch(plain), _AFTER_WORD.fullmatch(plain)
    if in_brackets is not None and _spelled(in_brackets[2]) and any(units):
        return in_brackets[2].strip()
    return after[2] if after is not None and unit_word(after[2]) in units else None


def _place(name: str, names: Sequence[str]) -> int | None:
    wanted = name.strip().strip("'\"").lower()
    if wanted in names:
        return names.index(wanted)
    if wanted.isascii() and wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    return None


def _scale(field: str, unit: str | None, *, units: Mapping[str, float]) -> float:
    scale = next(iter(units.values())) if unit is None else units.get(unit_word(_plain(unit)))
    if scale is None:
        raise UsageError(
            f"{field} has no unit {unit!r}",
            where="columns",
            hint=f"permitted units: {', '.join(filter(None, units)) or 'none'}",
        )
    return scale


def _missing(found: Columns, fields: ColumnFields) -> str | None:
    needed = next((field for field in fields.needed if field not in found), None)
    if needed is not None:
        return f"no column holds a {needed}"
    if ("lat" in found) != ("lon" in found) or ("x" in found) != ("y" in found):
        return "only one of the two coordinates has a column"
    return None if "lat" in found or "x" in found else "no column holds a position"
