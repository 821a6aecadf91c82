"""Solutions of RTKLIB (`.pos`): a position in each line, under a header of comments that begin with `%`.

RTKLIB, T. Takasu, manual 2.4.2, appendix B.1. The header says in which time the positions are (`GPST`, `UTC`
or `JST`), and which columns there are; deviations are converted to covariances.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.files.text_file import numbered_lines
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint
from webapp.missions.files.readers.time_units import utc_from_gps, utc_from_week
from webapp.missions.files.track_chunks import Findings, Piece
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_HEADER = re.compile(r"%\s*(GPST|UTC|JST)[\s,;]+(\S.*)")
_JST_AHEAD_S = 9 * 3600.0
_PLACES = ("latitude", "longitude", "height")
_NO_SOLUTION = 0.0


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the header says."""

    clock: str
    columns: dict[str, int]  # Index of each column, without the time
    split: re.Pattern[str]

    def point(self, line: str) -> LinePoint | None:
        """Parse a line; None for one without a solution. Raises ValueError, IndexError."""
        words = [word for word in self.split.split(line.strip()) if word]
        time_s, rest = self._time(words)
        row = [float(word) for word in rest]
        if row[self.columns["q"]] == _NO_SOLUTION:
            return None
        lat, lon = (_degrees(row[self.columns[name] :][: self._width(name)]) for name in _PLACES[:2])
        north, east, both = (self._deviation(row, name) for name in ("sdn", "sde", "sdne"))
        return LinePoint(
            time_s,
            lat,
            lon,
            row[self.columns["height"]],
            var_e=east**2,
            var_n=north**2,
            cov_en=math.copysign(both**2, both),
        )

    def _time(self, words: list[str]) -> tuple[float, list[str]]:
        if "/" in words[0]:
            seconds = unix_time(f"{words[0].replace('/', '-')} {words[1]}")
            if math.isnan(seconds):
                raise ValueError(words[0])
            if self.clock == "GPST":
                seconds = utc_from_gps(seconds)
            return seconds - (_JST_AHEAD_S if self.clock == "JST" else 0.0), words[2:]
        return utc_from_week(float(words[0]), float(words[1])), words[2:]

    def _width(self, name: str) -> int:
        """Number of columns of an angle: degrees, or degrees, minutes and seconds."""
        following = _PLACES[_PLACES.index(name) + 1]
        return self.columns[following] - self.columns[name]

    def _deviation(self, row: list[float], name: str) -> float:
        index = self.columns.get(name)
        return math.nan if index is None else row[index]


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a solution.

    Raises:
        TrackError: Its positions are not latitudes and longitudes.
    """
    layout: _Layout | None = None
    line = LineBuffer("", timed=True)
    for number, text in numbered_lines(file):
        where = f"line {number}"
        if text.startswith("%"):
            header = _HEADER.match(text)
            layout = layout if header is None else _layout(header)
            continue
        if layout is None or not text.strip():
            findings.skip("lines before the header", where=where, count=int(bool(text.strip())))
            continue
        try:
            point = layout.point(text)
        except (ValueError, IndexError):
            findings.skip("lines that are no solution", where=where)
            continue
        if point is None:
            findings.skip("times without a position", where=where)
        else:
            yield from line.add(point, findings=findings)
    if layout is not None and layout.clock != "UTC":
        findings.note(f"the times are those of {layout.clock}: they were converted to UTC")
    if line.count:
        yield from line.flush(findings)


def _layout(header: re.Match[str]) -> _Layout:
    """Find the columns: an angle in minutes and seconds takes three."""
    columns: dict[str, int] = {}
    at = 0
    for word in re.split(r"[\s,;]+", header[2].strip()):
        name, _, unit = word.partition("(")
        columns[name.lower()] = at
        at += 3 if "'" in unit else 1
    if not {*_PLACES, "q"} <= columns.keys():
        raise TrackError(
            f"the positions are {header[2].split('(')[0]}, not latitude and longitude",
            hint="choose Lat/Lon/Height as the format of solutions in RTKLIB",
        )
    separator = next((mark for mark in ",;" if mark in header[0]), r"\s")
    return _Layout(header[1], columns, re.compile(rf"[\s{separator}]+"))


def _degrees(parts: list[float]) -> float:
    """Convert degrees, minutes and seconds; the sign is that of the degrees, also of -0."""
    size = sum(abs(part) / 60.0**place for place, part in enumerate(parts))
    return math.copysign(size, parts[0])


FORMAT = TrackFormat(
    "rtklib",
    "RTKLIB solution",
    "RTKLIB",
    endings=(".pos",),
    is_one=lambda beginning: any(map(_HEADER.match, beginning.lines)),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    about=FormatAbout(
        tracks="latitude, longitude and height, with covariances from `sdn`, `sde`, `sdne`; GPST and JST are "
        "converted to UTC",
        left_out="lines without a solution",
        written_by="RTKLIB, RTKPOST, Emlid",
    ),
)
