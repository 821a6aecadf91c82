"""Sentences of NMEA 0183: positions, times and dates that they hold, or why they are left out."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from functools import reduce
from operator import xor
from typing import BinaryIO

from webapp.core.geo.types import LatLon
from webapp.files.text_file import numbered_lines
from webapp.missions.files.track_chunks import Findings

INVALID = "fixes marked invalid by the receiver"
ESTIMATED = "positions that the receiver estimated without satellites"
MADE_UP = "positions that were simulated or entered by hand"
CUT = "sentences that are cut off"

_LEAST = {"RMC": 9, "GGA": 6, "GNS": 6, "GLL": 4, "GST": 8, "ZDA": 4, "WPL": 5}
"""Sentences that are used, and how many fields they have at least."""

_AT = {"RMC": 2, "GGA": 1, "GNS": 1, "GLL": 0, "WPL": 0}
"""Index of the latitude, which is followed by N or S, the longitude, and E or W."""

_CLOCK_AT = {"GLL": 4}
_BY_MODE = {"N": INVALID, "E": ESTIMATED, "S": MADE_UP, "M": MADE_UP}
_BY_QUALITY = {0: INVALID, 6: ESTIMATED, 7: MADE_UP, 8: MADE_UP}
_SENTENCE = re.compile(r"([A-Z][A-Z0-9]{4,5}),([^*]*)(?:\*([0-9A-Fa-f]{2}).*)?", re.DOTALL)
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)")
_CLOCK = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_MOST_DEG = {"NS": 90.0, "EW": 180.0}
"""Of the letters of both sides; the second one is negative."""


class Unreadable(ValueError):
    """A sentence is left out; its text is the reason."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence that is used; unknown numbers are NaN."""

    kind: str  # RMC, GGA ...
    talker: str  # GP, GN ...
    clock: time | None = None
    day: date | None = None
    lat: float = math.nan
    lon: float = math.nan
    height_m: float = math.nan
    heading_deg: float = math.nan
    var_e: float = math.nan
    var_n: float = math.nan
    bad: str = ""  # Why its position is not used
    name: str = ""  # Of a waypoint

    @property
    def moment(self) -> datetime | None:
        """Date and time; None if either is unknown."""
        if self.day is None or self.clock is None:
            return None
        return datetime.combine(self.day, self.clock, tzinfo=UTC)

    @property
    def place(self) -> LatLon | None:
        return None if math.isnan(self.lat) else LatLon(self.lat, self.lon)


def is_sentence(line: str) -> bool:
    """Return whether a line holds an NMEA sentence, possibly after a logger's own time stamp."""
    _, dollar, body = line.partition("$")
    return bool(dollar) and len(body) > 6 and body[:5].isalnum() and body[:5].isupper() and body[5] == ","


def sentences(file: BinaryIO, *, checked: bool, findings: Findings) -> Iterator[tuple[str, Sentence]]:
    """Yield the sentences that are used, each with its line.

    Args:
        file: At its beginning.
        checked: Whether those of this log have checksums: one without is then damaged.
    """
    for number, line in numbered_lines(file):
        where = f"line {number}"
        if not is_sentence(line):
            findings.skip("lines that are no NMEA sentences", where=where, count=int(bool(line.strip())))
            continue
        for text in line.split("$")[1:]:
            if text[2:5] not in _LEAST:
                continue
            try:
                yield where, parse(text.strip(), checked=checked)
            except Unreadable as error:
                findings.skip(str(error), where=where)


def has_checksum(text: str) -> bool:
    return bool(re.search(r"\*[0-9A-Fa-f]{2}", text))


def parse(text: str, *, checked: bool) -> Sentence:
    """Parse a sentence without its dollar sign; text after the checksum is ignored.

    Raises:
        Unreadable
    """
    found = _SENTENCE.fullmatch(text)
    if found is None:
        raise Unreadable("sentences that cannot be read" if has_checksum(text) else CUT)
    if found[3] is None and checked:
        raise Unreadable(CUT)
    if found[3] is not None and reduce(xor, text.partition("*")[0].encode(), 0) != int(found[3], 16):
        raise Unreadable("sentences with a wrong checksum")
    talker, kind, fields = found[1][:2], found[1][2:5], [field.strip() for field in found[2].split(",")]
    if len(fields) < _LEAST[kind]:
        raise Unreadable("sentences that cannot be read" if found[3] else CUT)
    try:
        return _parsed(kind, talker, fields)
    except Unreadable:
        raise
    except ValueError as error:
        raise Unreadable("sentences that cannot be read") from error


def _parsed(kind: str, talker: str, fields: list[str]) -> Sentence:
    if kind == "WPL":
        lat, lon = _position(fields)
        if math.isnan(lat):
            raise Unreadable("waypoints without a position")
        return Sentence(kind, talker, lat=lat, lon=lon, name=" ".join(fields[4].split()))
    clock = _clock(_field(fields, _CLOCK_AT.get(kind, 0)))
    if kind == "ZDA":
        days = [int(field) if field else 0 for field in fields[1:4]]
        return Sentence(kind, talker, clock, date(days[2], days[1], days[0]) if days[2] else None)
    if kind == "GST":
        north, east = _number(fields[5]), _number(fields[6])
        return Sentence(kind, talker, clock, var_e=east**2, var_n=north**2)
    lat, lon = _position(fields[_AT[kind] :])
    bad = _bad(kind, fields)
    if kind != "RMC":
        height = _number(_field(fields, 8)) if kind in ("GGA", "GNS") else math.nan
        return Sentence(kind, talker, clock, lat=lat, lon=lon, height_m=height, bad=bad)
    day = datetime.strptime(fields[8], "%d%m%y").date() if fields[8] else None
    heading = _number(fields[7]) if _number(fields[6]) > 0.0 else math.nan
    return Sentence(kind, talker, clock, day, lat, lon, heading_deg=heading, bad=bad)


def _bad(kind: str, fields: list[str]) -> str:
    """Return why the position of a fix is not used; empty if it is."""
    if kind == "GGA":
        return _BY_QUALITY.get(int(fields[5]), "") if fields[5] else INVALID
    if kind == "GNS":
        modes = set(fields[5].upper()) - {"N"}
        return INVALID if not modes else _BY_MODE.get(modes.pop(), "") if len(modes) == 1 else ""
    status, mode = (1, 11) if kind == "RMC" else (5, 6)
    if _field(fields, status).upper() == "V":
        return INVALID
    return _BY_MODE.get(_field(fields, mode).upper(), "")


def _field(fields: list[str], index: int) -> str:
    return fields[index] if index < len(fields) else ""


def _number(text: str) -> float:
    return float(text) if text else math.nan


def _clock(text: str) -> time | None:
    if not text:
        return None
    found = _CLOCK.fullmatch(text)
    if found is None:
        raise ValueError(text)
    return time(int(found[1]), int(found[2]), int(found[3]), int(f"{found[4] or ''}000000"[:6]))


def _position(fields: list[str]) -> tuple[float, float]:
    """Return latitude and longitude; NaN if the fields are empty."""
    lat, north, lon, east = fields[:4]
    if not lat or not lon:
        return math.nan, math.nan
    return _degrees(lat, north, sides="NS"), _degrees(lon, east, sides="EW")


def _degrees(text: str, side: str, *, sides: str) -> float:
    """Convert an angle in degrees and minutes, `5005.100`, to degrees."""
    found = _ANGLE.fullmatch(text)
    if found is None or float(found[2]) >= 60.0:
        raise ValueError(text)
    if side.upper() not in tuple(sides):
        raise Unreadable("positions without N or S, or without E or W")
    size = int(found[1]) + float(found[2]) / 60.0
    if size > _MOST_DEG[sides]:
        raise ValueError(text)
    return -size if side.upper() == sides[1] else size
