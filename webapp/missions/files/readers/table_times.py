"""Which columns of a table have its times: absolute ones before relative ones, UTC before local time."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from webapp.core.columns import Column, Columns, candidates, unit_word
from webapp.files.exchange.cells import moment, quantity, seconds_of_day, split_datetime
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers.time_units import ticks

_ABSOLUTE_S = 1e8
"""1973: smaller numbers count from another moment, such as the start of the recording."""

_MOST_CANDIDATES = 20
"""Number of columns for times that are compared."""

_EXIF_DATE = re.compile(r"(\d{4}):(\d\d):(\d\d)(?=[ T]|$)")


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


def choose_times(
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


def plain_moment(text: str) -> str:
    """Write the date of a time as in Exif, `2026:05:01 10:00:00`, with hyphens."""
    return _EXIF_DATE.sub(r"\1-\2-\3", text, count=1) if text[4:5] == ":" else text


def _holds(column: Column, rows: Sequence[Sequence[str]], *, has_date: bool) -> _Holds:
    cells = [row[column.index].strip().lstrip("'") for row in rows if column.index < len(row)]
    found = Counter(_kind(cell, column.scale, has_date=has_date) for cell in cells if cell)
    return max(found, key=lambda one: (found[one], one), default=_Holds.NOTHING)


def _kind(cell: str, scale: float, *, has_date: bool) -> _Holds:
    cell = plain_moment(cell)
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
