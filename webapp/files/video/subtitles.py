"""Reads positions from the subtitles (SRT) that drones of DJI write beside a clip.

Two forms are in use: `[latitude: 50.1] [longitude: 14.2]` (also spelled `longtitude`), and
`GPS(14.2,50.1,18)` with the longitude first.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from webapp.core.geo.types import LatLon
from webapp.core.trajectory import FixTrack, make_track
from webapp.errors import TrackError
from webapp.files.text_file import numbered_lines
from webapp.files.video.clip import is_begin

SUFFIX = ".srt"

_CUE = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->")
_NUMBER = r"\s*:?\s*([+-]?\d+(?:\.\d+)?)"
_LATITUDE = re.compile(r"latitude" + _NUMBER, re.IGNORECASE)
_LONGITUDE = re.compile(r"longt?itude" + _NUMBER, re.IGNORECASE)
_GPS = re.compile(r"GPS\s*\(\s*([+-]?\d+(?:\.\d+)?)\s*,\s*([+-]?\d+(?:\.\d+)?)")
_CLOCK = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(?:[.,](\d{1,6}))?")


class Subtitles:
    """What subtitles say of a clip."""

    def __init__(self) -> None:
        self.clock: datetime | None = None  # The drone's clock at the first cue, without a time zone
        self._times: list[float] = []
        self._positions: list[LatLon] = []
        self._at_s: float | None = None

    @property
    def track(self) -> FixTrack:
        """The positions; times are seconds since the begin of the clip."""
        return make_track(self._times, self._positions)

    def read_line(self, line: str) -> None:
        """Take one line."""
        if cue := _CUE.match(line):
            hours, minutes, seconds, thousandths = map(int, cue.groups())
            self._at_s = 3600.0 * hours + 60.0 * minutes + seconds + thousandths / 1000.0
            return
        if self._at_s is None:
            return
        if self.clock is None and (clock := _CLOCK.search(line)):
            micro = (clock[2] or "0").ljust(6, "0")
            self.clock = _moment(f"{clock[1]}.{micro}")
        place = _place(line)
        # drones write 0, 0 while they have no fix
        if place is not None and (place.lat or place.lon) and abs(place.lat) <= 90 and abs(place.lon) <= 180:
            self._times.append(self._at_s)
            self._positions.append(place)


def read_subtitles(path: Path) -> Subtitles:
    """Read a file.

    Raises:
        TrackError: It cannot be read, or has no position.
    """
    found = Subtitles()
    try:
        with path.open("rb") as file:
            for _, line in numbered_lines(file):
                found.read_line(line)
    except OSError as problem:
        raise TrackError(f"the file cannot be read: {problem.strerror}", where=str(path)) from problem
    if not len(found.track):
        hint = "switch the captions of the drone on before the next flight"
        raise TrackError("the subtitles have no position", where=str(path), hint=hint)
    return found


def _place(line: str) -> LatLon | None:
    lat, lon = _LATITUDE.search(line), _LONGITUDE.search(line)
    if lat and lon:
        return LatLon(float(lat[1]), float(lon[1]))
    pair = _GPS.search(line)
    return LatLon(float(pair[2]), float(pair[1])) if pair else None


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f")
    except ValueError:
        return None
    return moment if is_begin(moment.replace(tzinfo=UTC).timestamp()) else None
