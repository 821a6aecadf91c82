"""IGC: flights recorded by loggers of gliders (FAI, Specification for GNSS Flight Recorders).

A `B` record is a fix: time of day, position, validity (3D or not), pressure altitude, GNSS altitude. The date
is in an `HFDTE` record; an `I` record declares extensions of the `B` records, such as additional digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from typing import BinaryIO

from webapp.errors import TrackError
from webapp.files.text_file import numbered_lines
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.files.track_chunks import CHUNK, Findings, Piece, WorldPiece
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_FIX = re.compile(
    r"B(\d\d)(\d\d)(\d\d)(\d\d)(\d{5})([NS])(\d{3})(\d{5})([EW])([AV])(-\d{4}|\d{5})(-\d{4}|\d{5})(.*)"
)
_DATE = re.compile(r"HFDTE(?:DATE:)?\s*(\d\d)(\d\d)(\d\d)")
_EXTENSION = re.compile(r"(\d\d)(\d\d)([A-Z0-9]{3})")
_HALF_DAY_S = 43_200.0


def is_igc(lines: list[str]) -> bool:
    """Return whether the first lines of a text are those of an IGC file."""
    has_records = (lines[:1] and lines[0][:1] == "A") or any(_FIX.fullmatch(line.strip()) for line in lines)
    return bool(has_records) and any(_DATE.match(line) for line in lines)


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a flight.

    Raises:
        TrackError: The file has no date before its first fix.
    """
    log = _Log()
    rows: list[tuple[float, ...]] = []
    for number, line in numbered_lines(file):
        row = log.row(line.strip(), f"line {number}", findings=findings)
        if row is None:
            continue
        rows.append(row)
        if len(rows) == CHUNK:
            yield _piece(rows)
            rows = []
    if rows:
        yield _piece(rows)


@dataclass(slots=True)
class _Log:
    """State of the parser after the records so far."""

    midnight_s: float = math.nan
    last_s: float = -math.inf
    digits: dict[str, slice] = field(default_factory=dict)
    """Columns of the extensions of a fix, by name."""

    def row(self, line: str, where: str, *, findings: Findings) -> tuple[float, ...] | None:
        day = _DATE.match(line)
        if day is not None:
            self.midnight_s = _midnight(day)
            self.last_s = -math.inf
        elif line.startswith("I"):
            found = _EXTENSION.findall(line[3:])
            self.digits = {name: slice(int(first) - 1, int(last)) for first, last, name in found}
        elif line.startswith("B"):
            fix = _FIX.fullmatch(line)
            if fix is not None:
                return self.fix(fix, line, where, findings=findings)
            findings.skip("fixes that cannot be read", where=where)
        elif line.startswith("C"):
            findings.skip("lines of a declared task, which is not a track", where=where)
        return None

    def fix(
        self, fix: re.Match[str], line: str, where: str, *, findings: Findings
    ) -> tuple[float, ...] | None:
        if math.isnan(self.midnight_s):
            raise TrackError("a fix comes before the date of the flight", where=where)
        if fix[4] + fix[5] + fix[7] + fix[8] == "0" * 15:
            findings.skip("fixes marked invalid by the receiver", where=where)
            return None
        clock = int(fix[1]) * 3600.0 + int(fix[2]) * 60.0 + int(fix[3]) + self.more(line, "TDS")
        if self.midnight_s + clock < self.last_s - _HALF_DAY_S:
            self.midnight_s += timedelta(days=1).total_seconds()
        self.last_s = self.midnight_s + clock
        lat = int(fix[4]) + (int(fix[5]) + self.more(line, "LAD")) / 60_000.0
        lon = int(fix[7]) + (int(fix[8]) + self.more(line, "LOD")) / 60_000.0
        height = float(fix[12]) if fix[10] == "A" else math.nan
        return (self.last_s, -lat if fix[6] == "S" else lat, -lon if fix[9] == "W" else lon, height)

    def more(self, line: str, name: str) -> float:
        """Return the additional digits of an extension, as decimals."""
        digits = line[self.digits[name]] if name in self.digits else ""
        return float(f"0.{digits}") if digits.isdecimal() else 0.0


def _midnight(day: re.Match[str]) -> float:
    year = int(day[3])
    try:
        found = date(year + (2000 if year < 80 else 1900), int(day[2]), int(day[1]))
    except ValueError as error:
        raise TrackError(f"the date {day[1]}{day[2]}{day[3]} does not exist", where="HFDTE") from error
    return datetime.combine(found, datetime.min.time(), tzinfo=UTC).timestamp()


def _piece(rows: list[tuple[float, ...]]) -> WorldPiece:
    times, lat, lon, height = zip(*rows, strict=True)
    return WorldPiece("", "gps", make_poses(times, list(zip(lat, lon, strict=True)), height_m=height))


FORMAT = TrackFormat(
    "igc",
    "IGC",
    "IGC",
    endings=(".igc",),
    is_one=lambda beginning: is_igc(beginning.lines),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    about=FormatAbout(
        tracks="the fixes of a flight, also past midnight, and the extra digits of `LAD`, `LOD`, `TDS`",
        left_out="declared tasks, pressure altitudes",
        written_by="flight recorders of gliders, XCSoar",
    ),
)
