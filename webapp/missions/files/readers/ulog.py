"""ULog: flight logs of PX4 (docs.px4.io, "ULog File Format"), whose definitions of messages are in the log.

Read are the receiver's positions and the estimated position in metres from where the log began (north, east,
down). Times count from the start of the autopilot; the receiver's fixes say when that was.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from webapp.errors import TrackError
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint
from webapp.missions.files.track_chunks import CHUNK, Findings, Piece, RobotPiece
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_MAGIC = b"ULog\x01\x12\x35"
_HEADER, _HEAD = 16, 3
_GPS, _LOCAL = "vehicle_gps_position", "vehicle_local_position"
_TYPES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I",
    "int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "c",
}  # fmt: skip
_FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? (\w+)")
_MAX_DEPTH = 10
_MAX_SIZE = 65_535
"""Bytes of a message, as its length is stated in two bytes."""

_MOST_EMPTY = 1000
"""Messages without content that a log may have: each takes as long as one with content."""

_APPENDED = 1
_2D = 2


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a log.

    Args:
        file: Must be seekable.

    Raises:
        TrackError: The file is no readable log.
    """
    started_s = _started(file)
    if math.isnan(started_s):
        findings.note("no fix has a time: times count from the start of the autopilot")
        started_s = 0.0
    lines: dict[str, LineBuffer] = {}
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name, values in _messages(file, findings=findings):
        time_s = started_s + values["timestamp"] * 1e-6
        if name.startswith(_GPS):
            if values.get("fix_type", 0) < _2D:
                findings.skip("fixes marked invalid by the receiver", where=name)
                continue
            line = lines.setdefault(name, LineBuffer(name, timed=True))
            yield from line.add(_fix(time_s, values), findings=findings)
        elif values.get("xy_valid", True):
            rows.setdefault(name, []).append(_local(time_s, values))
            if len(rows[name]) == CHUNK:
                yield _piece(name, rows.pop(name))
        else:
            findings.skip("estimates that the autopilot marks as invalid", where=name)
    for line in lines.values():
        yield from line.flush(findings)
    for name, rest in rows.items():
        yield _piece(name, rest)


def _fix(time_s: float, values: dict[str, Any]) -> LinePoint:
    """Convert a fix: PX4 1.14 and later have degrees and metres."""
    lat = values.get("latitude_deg", values.get("lat", math.nan) * 1e-7)
    lon = values.get("longitude_deg", values.get("lon", math.nan) * 1e-7)
    height = values.get("altitude_msl_m", values.get("alt", math.nan) * 1e-3)
    variance = values.get("eph", math.nan) ** 2 or math.nan
    moves = values.get("vel_m_s", 0.0) > 0.5
    heading = math.degrees(values["cog_rad"]) % 360.0 if moves and "cog_rad" in values else math.nan
    spread = (variance, variance, 0.0 if math.isfinite(variance) else math.nan)
    return LinePoint(time_s, lat, lon, height, heading, *spread)


def _local(time_s: float, values: dict[str, Any]) -> tuple[float, ...]:
    """Convert an estimate from north, east, down to forward, left, up."""
    return time_s, values["x"], -values["y"], -values["z"], -values.get("heading", math.nan)


def _piece(name: str, rows: list[tuple[float, ...]]) -> RobotPiece:
    table = np.array(rows)
    unknown = np.full((len(table), 3), np.nan)
    local = LocalPoses(table[:, 0], table[:, 1:4], table[:, 4], unknown)
    return RobotPiece(name, "odometry", "local", "base_link", local)


def _started(file: BinaryIO) -> float:
    """Return when the autopilot was started, from its first fix with a time; NaN without one."""
    for name, values in _messages(file, findings=Findings()):
        utc_us = values.get("time_utc_usec", 0)
        if name.startswith(_GPS) and values.get("fix_type", 0) >= _2D and utc_us:
            return float(utc_us - values["timestamp"]) * 1e-6
    return math.nan


@dataclass(slots=True)
class _Log:
    """Definitions and subscriptions so far."""

    formats: dict[str, list[tuple[str, int, str]]] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    layouts: dict[int, tuple[str, list[tuple[str, str, int]]]] = field(default_factory=dict)

    def define(self, text: str) -> None:
        name, _, fields = text.partition(":")
        found = [_FIELD.fullmatch(one.strip()) for one in fields.split(";") if one.strip()]
        if not all(found):
            raise TrackError(f"the definition of {name[:40]!r} in the log is damaged")
        self.formats[name] = [(one[1], int(one[2] or 0), one[3]) for one in found if one]

    def subscribe(self, data: bytes) -> None:
        instance, id_ = struct.unpack_from("<BH", data)
        name = data[3:].decode("utf-8", "replace")
        if name not in (_GPS, _LOCAL):
            return
        fields, at = [], 0
        for kind, count, label in self.formats.get(name, []):
            if kind in _TYPES and not count:
                fields.append((label, f"<{_TYPES[kind]}", at))
            at += self.size(kind, _MAX_DEPTH) * max(count, 1)
            if at > _MAX_SIZE:
                raise TrackError(f"a message of the log is longer than {_MAX_SIZE} bytes", where=name)
        labels = {label for label, _, _ in fields}
        needed = {"timestamp"} if name == _GPS else {"timestamp", "x", "y", "z"}
        if needed <= labels:
            self.layouts[id_] = (f"{name} {instance}" if instance else name, fields)

    def size(self, kind: str, depth: int) -> int:
        """Return the size of a type in bytes."""
        if kind in _TYPES:
            return struct.calcsize(f"<{_TYPES[kind]}")
        if not depth:
            raise TrackError(f"definitions of the log are nested more than {_MAX_DEPTH} deep")
        if kind not in self.sizes:
            inner = self.formats.get(kind, [])
            self.sizes[kind] = sum(self.size(one, depth - 1) * max(count, 1) for one, count, _ in inner)
        return self.sizes[kind]

    def values(self, data: bytes) -> tuple[str, dict[str, Any]] | None:
        """Decode a message; None if it is not used."""
        found = self.layouts.get(int.from_bytes(data[:2], "little"))
        if found is None:
            return None
        name, fields = found
        read = ((label, struct.unpack_from(code, data, at + 2)[0]) for label, code, at in fields)
        return name, dict(read)


def _messages(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[str, dict[str, Any]]]:
    file.seek(0)
    if not file.read(_HEADER).startswith(_MAGIC):
        raise TrackError("this is no ULog")
    log = _Log()
    appended: list[int] = []
    empty = 0
    while True:
        at = file.tell()
        head = file.read(_HEAD)
        size = int.from_bytes(head[:2], "little")
        data = file.read(size) if len(head) == _HEAD else b""
        beyond = next((one for one in appended if at < one < at + _HEAD + size), None)
        if beyond is not None:  # the message was cut where data was appended later
            file.seek(beyond)
            continue
        if len(head) < _HEAD or len(data) < size:
            findings.skip("messages that are cut off", where=f"byte {at}", count=int(bool(head)))
            return
        empty += not size
        if empty > _MOST_EMPTY:
            raise TrackError(f"the log has more than {_MOST_EMPTY} messages without content")
        try:
            found = _take(log, head[2:], data, appended=appended)
        except struct.error:
            findings.skip("messages that cannot be read", where=f"byte {at}")
            continue
        if found is not None:
            yield found


def _take(log: _Log, kind: bytes, data: bytes, *, appended: list[int]) -> tuple[str, dict[str, Any]] | None:
    match kind:
        case b"D":
            return log.values(data)
        case b"F":
            log.define(data.decode("utf-8", "replace"))
        case b"A":
            log.subscribe(data)
        case b"B":
            flags = struct.unpack_from("<8x8B3Q", data)
            if flags[0] & ~_APPENDED or any(flags[1:8]):
                raise TrackError("the ULog is of a later version", hint="convert it with tools of PX4")
            appended += [offset for offset in flags[8:] if offset]
    return None


FORMAT = TrackFormat(
    "ulog",
    "ULog",
    "ULog",
    endings=(".ulg", ".ulog"),
    is_one=lambda beginning: beginning.head.startswith(_MAGIC),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    about=FormatAbout(
        tracks="`vehicle_gps_position`, each receiver; `vehicle_local_position` in metres",
        left_out="other topics",
        written_by="PX4",
    ),
)
