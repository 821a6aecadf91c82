"""NMEA 0183 logs of GPS receivers.

Consecutive sentences with the same time of day form one fix: RMC has the date, position, speed and course,
GGA position and height, GLL position, GST the accuracy. A fix without a date gets the one that puts it
nearest to the previous fix. WPL is a waypoint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any, BinaryIO

from webapp.core.geo.types import LatLon
from webapp.extras import extra
from webapp.files.text_file import numbered_lines
from webapp.missions.core.trajectory.records import Sighting, make_poses
from webapp.missions.files.track_chunks import (
    CHUNK,
    UNTIMED_OBJECTS,
    Findings,
    Piece,
    WorldObjects,
    WorldPiece,
)
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_USED = {"RMC", "GGA", "GLL", "GST", "ZDA", "WPL"}
_BROKEN = (ValueError, TypeError, AttributeError, IndexError, KeyError)
"""Exceptions for fields that are not numbers, and for the library's own errors (subclasses of ValueError)."""


@dataclass(slots=True)
class _Fix:
    """A fix, merged from the sentences with one time of day."""

    clock: time
    lat: float = math.nan
    lon: float = math.nan
    height_m: float = math.nan
    heading_deg: float = math.nan
    var_e: float = math.nan
    var_n: float = math.nan
    valid: bool = True


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a log; sentences of other types are ignored.

    Args:
        file: At its beginning; must be seekable.
    """
    rows: list[tuple[float, ...]] = []
    for row in _fixes(file, findings=findings):
        if isinstance(row, Sighting):
            yield WorldObjects((row,))
            continue
        rows.append(row)
        if len(rows) == CHUNK:
            yield _piece(rows)
            rows = []
    if rows:
        yield _piece(rows)


def is_sentence(line: str) -> bool:
    """Return whether a line holds an NMEA sentence, possibly after a logger's own time stamp."""
    _, dollar, body = line.partition("$")
    return bool(dollar) and len(body) > 6 and body[:5].isalnum() and body[:5].isupper() and body[5] == ","


def _fixes(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[float, ...] | Sighting]:
    calendar = _Calendar(_first_date(file))
    file.seek(0)
    fix: _Fix | None = None
    where = "line 1"
    for where, message in _sentences(file, findings=findings):
        if message.sentence_type == "WPL":
            findings.note(UNTIMED_OBJECTS)
            yield _waypoint(message)
            continue
        if calendar.near is None:
            findings.note("no sentence has a date: times count from 1970-01-01")
        clock = message.timestamp
        if not isinstance(clock, time):
            findings.skip("sentences without a time", where=where)
            continue
        if fix is not None and fix.clock != clock:
            yield from _finished(fix, calendar, findings=findings, where=where)
            fix = None
        calendar.near = _dated(message) or calendar.near
        if message.sentence_type != "ZDA":
            fix = fix or _Fix(clock)
            _take(fix, message)
    if fix is not None:
        yield from _finished(fix, calendar, findings=findings, where=where)


@dataclass(slots=True)
class _Calendar:
    """Infers dates: a time of day belongs to the day that puts it nearest to the last known moment."""

    near: datetime | None

    def unix_time(self, clock: time) -> float:
        near = self.near or datetime.combine(date(1970, 1, 1), clock, tzinfo=UTC)
        days = [near.date() + timedelta(days=k) for k in (-1, 0, 1)]
        moments = [datetime.combine(day, clock, tzinfo=UTC) for day in days]
        self.near = min(moments, key=lambda moment: abs(moment - near))
        return self.near.timestamp()


def _finished(
    fix: _Fix, calendar: _Calendar, *, findings: Findings, where: str
) -> Iterator[tuple[float, ...]]:
    when = calendar.unix_time(fix.clock)
    if not fix.valid:
        findings.skip("fixes marked invalid by the receiver", where=where)
    elif math.isnan(fix.lat):
        findings.skip("times without a position", where=where)
    else:
        yield (when, fix.lat, fix.lon, fix.height_m, fix.heading_deg, fix.var_e, fix.var_n)


def _take(fix: _Fix, message: Any) -> None:
    """Merge a sentence into a fix."""
    kind = message.sentence_type
    if kind == "GST":
        fix.var_e, fix.var_n = _squared(message.std_dev_longitude), _squared(message.std_dev_latitude)
        return
    fix.valid = fix.valid and (bool(message.gps_qual) if kind == "GGA" else message.status != "V")
    if message.lat and message.lon:
        fix.lat, fix.lon = float(message.latitude), float(message.longitude)
    if kind == "GGA" and message.altitude is not None:
        fix.height_m = float(message.altitude)
    if kind == "RMC" and message.true_course is not None and (message.spd_over_grnd or 0.0) > 0.0:
        fix.heading_deg = float(message.true_course)


def _squared(deviation: float | None) -> float:
    return math.nan if deviation is None else float(deviation) ** 2


def _dated(message: Any) -> datetime | None:
    """Return the date and time of a sentence, if it has a date."""
    clock: time = message.timestamp
    if message.sentence_type == "RMC" and isinstance(message.datestamp, date):
        return datetime.combine(message.datestamp, clock, tzinfo=UTC)
    if message.sentence_type == "ZDA" and message.year:
        return datetime.combine(date(message.year, message.month, message.day), clock, tzinfo=UTC)
    return None


def _sentences(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[str, Any]]:
    with extra("missions"):
        import pynmea2
    for number, line in numbered_lines(file):
        where = f"line {number}"
        if not is_sentence(line):
            findings.skip("lines that are no NMEA sentences", where=where, count=int(bool(line.strip())))
            continue
        sentence = line[line.index("$") :].strip()
        if sentence[3:6] not in _USED:
            continue
        try:
            message = pynmea2.parse(sentence, check="*" in sentence)
            _understood(message)
        except pynmea2.ChecksumError:
            findings.skip("sentences with a wrong checksum", where=where)
        except _BROKEN:
            findings.skip("sentences that cannot be read", where=where)
        else:
            yield where, message


def _waypoint(message: Any) -> Sighting:
    name = " ".join(message.waypoint_id.split())
    at = LatLon(_degrees(message.lat, message.lat_dir), _degrees(message.lon, message.lon_dir))
    return Sighting(f"waypoint {name}".strip(), "waypoint", 0.0, at)


def _degrees(text: str, hemisphere: str) -> float:
    """Convert an angle in degrees and minutes, `5005.100`, to degrees."""
    whole = float(text) // 100.0
    size = whole + (float(text) - 100.0 * whole) / 60.0
    return -size if hemisphere in ("S", "W") else size


def _understood(message: Any) -> None:
    """Access every field that will be used, since the library parses fields, and raises, on access."""
    if message.sentence_type == "WPL":
        _waypoint(message)
        return
    if isinstance(message.timestamp, time):
        _dated(message)
    if message.sentence_type != "ZDA":
        _take(_Fix(time()), message)


def _first_date(file: BinaryIO) -> datetime | None:
    """Find the first date, which also serves for the fixes before it."""
    for _, message in _sentences(file, findings=Findings()):
        clock = getattr(message, "timestamp", None)
        found = _dated(message) if isinstance(clock, time) else None
        if found is not None:
            return found
    return None


def _piece(rows: list[tuple[float, ...]]) -> WorldPiece:
    times, lat, lon, height, heading, var_e, var_n = (list(column) for column in zip(*rows, strict=True))
    covariance = [(e, n, 0.0 if not math.isnan(e) else math.nan) for e, n in zip(var_e, var_n, strict=True)]
    latlon = list(zip(lat, lon, strict=True))
    return WorldPiece(
        "",
        "gps",
        make_poses(times, latlon, height_m=height, heading_deg=heading, covariance_m2=covariance),
    )


FORMAT = TrackFormat(
    "nmea",
    "NMEA 0183",
    "NMEA",
    endings=(".nmea", ".nma", ".log"),
    is_one=lambda beginning: any(map(is_sentence, beginning.lines)),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    needs="missions",
    numbered="waypoint",
    about=FormatAbout(
        tracks="RMC, GGA, GLL, with ZDA for the date and GST for the accuracy",
        objects="WPL",
        left_out="other sentences, fixes that the receiver marks as invalid",
        written_by="GPS receivers, chart plotters",
    ),
)
