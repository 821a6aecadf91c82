"""Logs of ArduPilot: DataFlash (`.bin`), written on board, and telemetry (`.tlog`), written on the ground.

A DataFlash log defines its messages itself, in messages `FMT`. A telemetry log has packets of MAVLink 1
and 2, each after the time at which it was received. Read are the positions of receivers:
`GPS`, `GPS2` and `GPS_RAW_INT`.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, BinaryIO, NamedTuple

from webapp.errors import TrackError
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint
from webapp.missions.files.readers.time_units import utc_from_week
from webapp.missions.files.track_chunks import Findings, Piece
from webapp.missions.files.track_format import Beginning, FormatAbout, TrackFormat, opened

_HEAD = b"\xa3\x95"
_FMT = 128
_FMT_BODY = struct.Struct("<BB4s16s64s")
_CODES = {
    "a": "64s", "b": "b", "B": "B", "c": "h", "C": "H", "d": "d", "e": "i", "E": "I", "f": "f", "g": "2s",
    "h": "h", "H": "H", "i": "i", "I": "I", "L": "i", "M": "B", "n": "4s", "N": "16s", "q": "q",
    "Q": "Q", "Z": "64s",
}  # fmt: skip
_SCALES = {"c": 1e-2, "C": 1e-2, "e": 1e-2, "E": 1e-2, "L": 1e-7}
_BLOCK = 1 << 16
_MOST_BROKEN = 100_000
"""Places at which a log is damaged: looking for the next message takes time."""

_2D = 2
_MOVES_MPS = 0.5

_V1, _V2 = 0xFE, 0xFD
_RAW_INT, _RAW_EXTRA = 24, 24
_RAW_BODY = struct.Struct("<Qiii4HBB")
_UNKNOWN = 65_535
_YEARS_US = (1_100_000_000_000_000, 4_100_000_000_000_000)
"""2004 and 2099: times of telemetry logs."""

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Bytes with their bits in reverse: the checksum takes the last bit first, `binascii` the first."""

BROKEN = "bytes that are no message"
INVALID = "fixes marked invalid by the receiver"


class _Message(NamedTuple):
    """A definition of a DataFlash log."""

    name: str
    body: struct.Struct
    labels: list[str]
    scales: list[float]


def read_dataflash(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a DataFlash log."""
    known: dict[int, _Message] = {}
    lines: dict[str, LineBuffer] = {}
    for name, values in _dataflash(file, known, findings=findings):
        instance = values.get("I", 0)
        track = f"{name} {instance:.0f}" if instance else name
        week, ms = values.get("GWk", values.get("Week")), values.get("GMS", values.get("TimeMS"))
        if values.get("Status", 0) < _2D or not week or ms is None:
            findings.skip(INVALID, where=track)
            continue
        moves = values.get("Spd", 0.0) > _MOVES_MPS
        point = LinePoint(
            utc_from_week(week, ms * 1e-3),
            values.get("Lat", math.nan),
            values.get("Lng", math.nan),
            values.get("Alt", math.nan),
            values.get("GCrs", math.nan) % 360.0 if moves else math.nan,
        )
        yield from lines.setdefault(track, LineBuffer(track, timed=True)).add(point, findings=findings)
    for line in lines.values():
        yield from line.flush(findings)


def _dataflash(
    file: BinaryIO, known: dict[int, _Message], *, findings: Findings
) -> Iterator[tuple[str, dict[str, Any]]]:
    data, at, begin, broken = b"", 0, 0, 0
    while True:
        if len(data) - at < _BLOCK:
            more = file.read(_BLOCK)
            begin += at
            data, at = data[at:] + more, 0
        if len(data) - at < 3:
            return
        message = known.get(data[at + 2]) if data[at : at + 2] == _HEAD else None
        body = _FMT_BODY if data[at : at + 3] == _HEAD + bytes([_FMT]) else message and message.body
        if body is None:
            after = data.find(_HEAD, at + 1)
            at = after if after >= 0 else len(data)
            broken += 1
            _broken(broken, begin + at, findings=findings)
            continue
        if len(data) - at - 3 < body.size:
            findings.skip("messages that are cut off", where=f"byte {begin + at}")
            return
        found = body.unpack_from(data, at + 3)
        at += 3 + body.size
        if body is _FMT_BODY:
            _define(known, found)
        elif message is not None and message.labels:
            pairs = zip(message.labels, found, message.scales, strict=False)
            numbers = {label: value * scale for label, value, scale in pairs if not isinstance(value, bytes)}
            yield message.name, numbers


def _define(known: dict[int, _Message], found: tuple[Any, ...]) -> None:
    """Remember a definition; of messages that are not used only their length."""
    id_, length, name, codes, labels = found
    text, used = (part.rstrip(b"\0").decode("latin-1") for part in (codes, labels))
    title = name.rstrip(b"\0").decode("latin-1")
    body = struct.Struct("<" + "".join(_CODES.get(code, "") for code in text))
    if title in ("GPS", "GPS2") and body.size == length - 3:
        scales = [_SCALES.get(code, 1) for code in text]
        known[id_] = _Message(title, body, used.split(","), scales)
    elif id_ != _FMT:
        known[id_] = _Message(title, struct.Struct(f"{max(length - 3, 0)}x"), [], [])


def read_telemetry(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a telemetry log; each vehicle is a track."""
    lines: dict[str, LineBuffer] = {}
    for time_us, system, payload in _packets(file, findings=findings):
        _, lat, lon, alt, _, _, speed, course, fix, _ = _RAW_BODY.unpack(payload)
        track = f"vehicle {system}"
        if fix < _2D:
            findings.skip(INVALID, where=track)
            continue
        moves = speed != _UNKNOWN and speed * 1e-2 > _MOVES_MPS and course != _UNKNOWN
        heading = course * 1e-2 if moves else math.nan
        point = LinePoint(time_us * 1e-6, lat * 1e-7, lon * 1e-7, alt * 1e-3, heading)
        yield from lines.setdefault(track, LineBuffer(track, timed=True)).add(point, findings=findings)
    for line in lines.values():
        yield from line.flush(findings)


def _packets(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[int, int, bytes]]:
    """Yield the raw fixes: microseconds since 1970, the vehicle's number, and the payload."""
    data, at, begin, broken = b"", 0, 0, 0
    while True:
        if len(data) - at < _BLOCK:
            begin += at
            data, at = data[at:] + file.read(_BLOCK), 0
        if len(data) - at < 8 + 8:
            return
        size = packet_size(data, at)
        if size is None:
            broken += 1
            _broken(broken, begin + at, findings=findings)
            at += 1
            continue
        packet = data[at + 8 : at + 8 + size]
        if len(packet) < size:
            findings.skip("packets that are cut off", where=f"byte {begin + at}")
            return
        is_v2 = packet[0] == _V2
        id_ = int.from_bytes(packet[7:10] if is_v2 else packet[5:6], "little")
        head = 10 if is_v2 else 6
        if id_ == _RAW_INT:
            body = packet[head : head + packet[1]]
            if checksum(packet[1 : head + packet[1]], _RAW_EXTRA) != packet[head + packet[1] :][:2]:
                findings.skip("packets with a wrong checksum", where=f"byte {begin + at}")
            else:  # MAVLink 2 leaves out zeros at the end, and may add fields
                time_us = int.from_bytes(data[at : at + 8], "big")
                whole = body[: _RAW_BODY.size].ljust(_RAW_BODY.size, b"\0")
                yield time_us, packet[5 if is_v2 else 3], whole
        at += 8 + size


def _broken(count: int, at: int, *, findings: Findings) -> None:
    """Count a place at which a log is damaged; raises TrackError if there are very many."""
    findings.skip(BROKEN, where=f"byte {at}")
    if count > _MOST_BROKEN:
        raise TrackError(f"the log is damaged at more than {_MOST_BROKEN} places")


def packet_size(data: bytes, at: int) -> int | None:
    """Return the size of the packet that follows the time at a byte; None if there is none."""
    time_us = int.from_bytes(data[at : at + 8], "big")
    if not _YEARS_US[0] < time_us < _YEARS_US[1] or len(data) < at + 11:
        return None
    mark, length, flags = data[at + 8], data[at + 9], data[at + 10]
    if mark == _V1:
        return 6 + length + 2
    return 10 + length + 2 + (13 if flags & 1 else 0) if mark == _V2 else None


def checksum(data: bytes, extra: int) -> bytes:
    """Compute the checksum of a packet: CRC-16/MCRF4XX, over the packet and a byte of the message's kind."""
    value = binascii.crc_hqx((data + bytes([extra])).translate(_REVERSED), 0xFFFF)
    return value.to_bytes(2, "big").translate(_REVERSED)


def _is_telemetry(beginning: Beginning) -> bool:
    size = packet_size(beginning.head, 0)
    if size is None:
        return False
    after = 8 + size
    return len(beginning.head) < after + 11 or packet_size(beginning.head, after) is not None


_DATAFLASH = TrackFormat(
    "dataflash",
    "DataFlash log",
    "DataFlash",
    endings=(".bin",),
    is_one=lambda beginning: beginning.head.startswith(_HEAD + bytes([_FMT])),
    read=opened(lambda file, _, findings: read_dataflash(file, findings=findings)),
    about=FormatAbout(
        tracks="`GPS` and `GPS2`, each receiver", left_out="other messages", written_by="ArduPilot"
    ),
)
_TELEMETRY = replace(
    _DATAFLASH,
    name="tlog",
    title="MAVLink telemetry log",
    called="MAVLink",
    endings=(".tlog",),
    is_one=_is_telemetry,
    read=opened(lambda file, _, findings: read_telemetry(file, findings=findings)),
    about=FormatAbout(
        tracks="`GPS_RAW_INT`, each vehicle; times are those of the computer that recorded",
        left_out="other messages",
        written_by="Mission Planner, QGroundControl, MAVProxy",
    ),
)
FORMATS = (_DATAFLASH, _TELEMETRY)
