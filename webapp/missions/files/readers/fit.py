"""FIT: activities and courses of Garmin's and other makers' watches and bicycle computers.

Positions are in `record` messages, in semicircles: 2^31 units are 180 degrees.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, BinaryIO

from webapp.errors import TrackError
from webapp.extras import extra
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint, mostly_timed
from webapp.missions.files.track_chunks import Findings, Piece
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

MAX_BYTES = 50_000_000
"""Maximum file size: all records are held in memory; a day of cycling takes a few megabytes."""

_TINY, _MAX_TINY = 4, 1000
"""Bytes of a message that holds hardly anything, and how many of these a file may have: decoding one takes as
long as decoding a position."""

_DEG = 180.0 / 2**31
_LEFT_OUT = {
    "course_point": "points of a course, which are also on its track",
    "location": "places saved on the device, which are not a track",
    "unknown_29": "places saved on the device, which are not a track",
}


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read the track of a file.

    Raises:
        TrackError: The file is too large, or damaged.
        MissingPart: fitdecode is not installed.
    """
    if file.seek(0, os.SEEK_END) > MAX_BYTES:
        raise TrackError(
            f"the FIT file is larger than {MAX_BYTES // 10**6} MB", hint="split it on the device"
        )
    file.seek(0)
    files = [points for points in _points(file, findings=findings) if points]
    for number, points in enumerate(files, 1):
        line = LineBuffer(f"part {number}" if len(files) > 1 else "", timed=mostly_timed(points))
        for point in points:
            yield from line.add(point, findings=findings)
        yield from line.flush(findings)


def is_fit(head: bytes) -> bool:
    """Return whether a file begins with the header of FIT."""
    return len(head) >= 12 and head[0] in (12, 14) and head[8:12] == b".FIT"


def _points(file: BinaryIO, *, findings: Findings) -> list[list[LinePoint]]:
    """Return the points of each file of a chain, which is usually one file."""
    with extra("missions"):
        import fitdecode
    files: list[list[LinePoint]] = [[]]
    tiny = 0
    try:
        with warnings.catch_warnings():  # about manufacturers' own fields, which are not used
            warnings.simplefilter("ignore")
            with fitdecode.FitReader(file, check_crc=fitdecode.CrcCheck.RAISE) as reader:
                for frame in reader:
                    if frame.frame_type == fitdecode.FIT_FRAME_HEADER:
                        files.append([])
                    elif frame.frame_type == fitdecode.FIT_FRAME_DATA:
                        files[-1] += _point(frame, findings=findings)
                        tiny += sum(field.size for field in frame.def_mesg.all_field_defs) < _TINY
                        if tiny > _MAX_TINY:
                            raise TrackError(
                                f"the FIT file has more than {_MAX_TINY} messages without content"
                            )
    except (MemoryError, TrackError):
        raise
    except Exception as error:  # its parsers raise arbitrary exceptions for damaged files
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise TrackError(f"the FIT file is damaged: {said}", hint="copy it from the device again") from error
    return files


def _point(message: Any, *, findings: Findings) -> list[LinePoint]:
    if message.name != "record":
        findings.skip(
            _LEFT_OUT.get(message.name, ""), where=message.name, count=int(message.name in _LEFT_OUT)
        )
        return []
    lat, lon = _number(message, "position_lat") * _DEG, _number(message, "position_long") * _DEG
    if math.isnan(lat) or math.isnan(lon):
        findings.skip("records without a position", where="record")
        return []
    height = _number(message, "enhanced_altitude")
    height = _number(message, "altitude") if math.isnan(height) else height
    return [LinePoint(_time(message), lat, lon, height)]


def _number(message: Any, name: str) -> float:
    value = message.get_value(name, fallback=None)
    return float(value) if isinstance(value, int | float) else math.nan


def _time(message: Any) -> float:
    value = message.get_value("timestamp", fallback=None)
    if not isinstance(value, datetime):
        return math.nan
    return value.replace(tzinfo=value.tzinfo or UTC).timestamp()


FORMAT = TrackFormat(
    "fit",
    "FIT",
    "FIT",
    endings=(".fit",),
    is_one=lambda beginning: is_fit(beginning.head),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    needs="missions",
    preload=("fitdecode",),
    about=FormatAbout(
        tracks=f"the records of an activity or a course; up to {MAX_BYTES // 10**6} MB; each file of a chain "
        "is a track",
        left_out="course points, saved places, heart rate",
        written_by="watches and bicycle computers of Garmin, Wahoo, Coros, Suunto",
    ),
)
