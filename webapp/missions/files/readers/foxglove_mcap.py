"""MCAP files of Foxglove, such as our own export: `foxglove.LocationFix` and `foxglove.GeoJSON`.

Recordings of ROS, with the profile `ros2` in their header, are read by `rosbag.py`. The container is
described at https://mcap.dev/spec, the messages at docs.foxglove.dev ("Message schemas").
"""

from __future__ import annotations

import io
import json
import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.missions.core.trajectory.records import SOURCES, Source
from webapp.missions.files.readers import geojson_reader
from webapp.missions.files.readers.bag_limits import MAX_CHUNK, mcap_decompressors, unpacked
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint
from webapp.missions.files.track_chunks import Findings, Piece, WorldObjects
from webapp.missions.files.track_format import Beginning, FormatAbout, TrackFormat, opened

_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 1, 2, 3, 4, 5, 6, 15
_HEAD = struct.Struct("<BQ")
_FIX, _SHAPES = "foxglove.LocationFix", "foxglove.GeoJSON"
_OWN = "/tracks/"
"""Before source and name of a track in the topics of our own export."""

_DAMAGED = (struct.error, ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError)
"""Exceptions of decoding, for damaged records."""

_MOST_EMPTY = 1000
"""Records without content: each takes as long as one with content."""


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a file.

    Raises:
        TrackError: It is damaged, or has no topic that can be read.
        MissingPart: Its chunks are compressed, and rosbags is not installed.
    """
    lines: dict[str, LineBuffer] = {}
    shapes: dict[str, bytes] = {}
    for topic, found in _messages(file, findings=findings):
        if isinstance(found, bytes):
            shapes[topic] = found  # a later one replaces it
            continue
        source, name = _track(topic)
        line = lines.setdefault(topic, LineBuffer(name, timed=True, source=source))
        yield from line.add(found, findings=findings)
    for line in lines.values():
        yield from line.flush(findings)
    for data in shapes.values():
        for piece in geojson_reader.read(io.BytesIO(data), findings=findings):
            if isinstance(piece, WorldObjects) or not lines:  # its lines repeat the fixes
                yield piece
    if not lines and not shapes:
        raise TrackError(
            f"the MCAP file has no messages of {_FIX} or {_SHAPES}",
            hint="recordings of ROS 2 are read if their header has the profile ros2",
        )


def _track(topic: str) -> tuple[Source, str]:
    """Return source and name of a track, which the topics of our own export consist of."""
    source, _, name = topic.removeprefix(_OWN).partition("/")
    if topic.startswith(_OWN) and source in SOURCES:
        return next(known for known in SOURCES if known == source), name
    return "gps", topic


def _point(message: Mapping[str, Any], recorded_s: float) -> LinePoint:
    """Convert a message; fields that have their default values are not in it."""
    lat, lon = (float(message.get(name, 0.0)) for name in ("latitude", "longitude"))
    covariance = [float(value) for value in message.get("position_covariance", ())]
    known = bool(message.get("position_covariance_type")) and len(covariance) >= 5
    spread = (covariance[0], covariance[4], covariance[1]) if known else (math.nan,) * 3
    return LinePoint(
        message.get("time_s") or recorded_s,
        lat,
        lon,
        float(message.get("altitude") or math.nan),
        float(message.get("heading", math.nan)),
        *spread,
    )


@dataclass(slots=True)
class _Log:
    """Schemas and channels so far."""

    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    channels: dict[int, tuple[str, str, str]] = field(default_factory=dict)

    def define(self, data: bytes) -> None:
        rest = io.BytesIO(data)
        number = int.from_bytes(rest.read(2), "little")
        self.schemas[number] = (_text(rest), _text(rest))

    def open(self, data: bytes) -> None:
        rest = io.BytesIO(data)
        number, schema = struct.unpack("<HH", _exactly(rest, 4))
        self.channels[number] = (_text(rest), _text(rest), self.schemas.get(schema, ("", ""))[0])


def _messages(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[str, LinePoint | bytes]]:
    """Yield topic and content of the messages that are used: a point, or GeoJSON."""
    log = _Log()
    for code, data in _records(file, findings=findings):
        try:
            if code == _SCHEMA:
                log.define(data)
            elif code == _CHANNEL:
                log.open(data)
            elif code == _MESSAGE:
                number, _, at_ns, _ = struct.unpack_from("<HIQQ", data)
                topic, encoding, kind = log.channels.get(number, ("", "", ""))
                if kind not in (_FIX, _SHAPES) or encoding not in _DECODE:
                    reason = f"messages of a topic of type {kind or encoding}, which is not used"
                    findings.skip(reason, where=topic)
                    continue
                message = _DECODE[encoding](data[22:], kind)
                yield topic, message["geojson"] if kind == _SHAPES else _point(message, at_ns * 1e-9)
        except _DAMAGED:
            findings.skip("records that are damaged", where=f"record of kind {code}")


def _records(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of the records, also of those in chunks, up to the end of the data."""
    file.seek(len(_MAGIC))
    for code, data in _in(file, findings=findings):
        if code in (_DATA_END, _FOOTER):
            return
        if code != _CHUNK:
            yield code, data
            continue
        size, compression, packed = _chunk(data)
        if compression:
            start = mcap_decompressors().get(compression)
            if start is None:
                raise TrackError(
                    f"chunks of the MCAP are compressed by {compression[:20]!r}, which is unknown"
                )
            packed = unpacked(packed, size=size, start=start)
        yield from _in(io.BytesIO(packed), findings=findings)
    findings.note("the recording was cut off: what is before that was read")


def _chunk(data: bytes) -> tuple[int, str, bytes]:
    """Return the size of a chunk's records, how they are compressed, and the compressed records."""
    try:
        size = struct.unpack_from("<16xQ4x", data)[0]
        rest = io.BytesIO(data[28:])
        compression = _text(rest)
        _exactly(rest, 8)
    except (struct.error, ValueError) as error:
        raise TrackError("a chunk of the MCAP file is damaged", hint="export it again") from error
    return size, compression, rest.read()


def _in(file: BinaryIO, *, findings: Findings) -> Iterator[tuple[int, bytes]]:
    empty = 0
    while head := file.read(_HEAD.size):
        code, size = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        if size > MAX_CHUNK:
            raise TrackError(f"a record of the MCAP file claims to have {size / 1e6:.0f} MB")
        empty += not size
        if empty > _MOST_EMPTY:
            raise TrackError(f"the MCAP file has more than {_MOST_EMPTY} records without content")
        data = file.read(size)
        if len(head) < _HEAD.size or len(data) < size:
            findings.skip("records that are cut off", where=f"record of kind {code}")
            return
        yield code, data


def _exactly(data: BinaryIO, size: int) -> bytes:
    found = data.read(size)
    if len(found) < size:
        raise ValueError("too short")
    return found


def _text(data: BinaryIO) -> str:
    return _exactly(data, int.from_bytes(_exactly(data, 4), "little")).decode("utf-8")


_FIELDS = {
    1: "latitude",
    2: "longitude",
    3: "altitude",
    4: "position_covariance",
    5: "position_covariance_type",
    6: "timestamp",
    10: "heading",
}
"""Of `foxglove.LocationFix` in Protocol Buffers."""


def _of_protobuf(data: bytes, kind: str) -> dict[str, Any]:
    fields = list(_protobuf(data))
    if kind == _SHAPES:
        return {"geojson": bytes(dict(fields)[1])}
    found: dict[str, Any] = {"position_covariance": []}
    for number, value in fields:
        name = _FIELDS.get(number)
        if name == "position_covariance":
            packed = value if isinstance(value, bytes) else struct.pack("<d", value)
            found[name] += struct.unpack(f"<{len(packed) // 8}d", packed)
        elif name == "timestamp":
            parts = dict(_protobuf(value))
            found["time_s"] = parts.get(1, 0) + parts.get(2, 0) * 1e-9
        elif name is not None:
            found[name] = value
    return found


def _protobuf(data: bytes) -> Iterator[tuple[int, Any]]:
    """Yield number and value of each field: an int, a float for 64 and 32 bits, or bytes."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while shift < 64:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7
        raise ValueError("a number without end")

    while at < len(data):
        number, wire = divmod(varint(), 8)
        if wire == 0:
            yield number, varint()
        elif wire in (1, 5):
            size = 8 if wire == 1 else 4
            yield number, struct.unpack_from("<d" if wire == 1 else "<f", data, at)[0]
            at += size
        elif wire == 2:
            size = varint()
            if at + size > len(data):
                raise ValueError("too short")
            yield number, data[at : at + size]
            at += size
        else:
            raise ValueError("a field of an unknown kind")


def _of_json(data: bytes, kind: str) -> dict[str, Any]:
    found: dict[str, Any] = dict(json.loads(data))
    if kind == _SHAPES:
        return {"geojson": found["geojson"].encode("utf-8", "replace")}
    at = found.get("timestamp")
    if isinstance(at, dict):
        found["time_s"] = at.get("sec", 0) + at.get("nsec", 0) * 1e-9
    elif isinstance(at, str):
        found["time_s"] = unix_time(at)
    return found


_DECODE = {"protobuf": _of_protobuf, "json": _of_json}


def _is_one(beginning: Beginning) -> bool:
    """Return whether a file is an MCAP without the profile of ROS 2."""
    if not beginning.head.startswith(_MAGIC):
        return False
    length = int.from_bytes(beginning.head[17:21], "little")
    return beginning.head[8:9] == bytes([_HEADER]) and not beginning.head[21 : 21 + length].startswith(b"ros")


FORMAT = TrackFormat(
    "foxglove",
    "Foxglove (MCAP)",
    "MCAP",
    endings=(".mcap",),
    is_one=_is_one,
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    needs="missions",
    preload=("rosbags.rosbag2.storage_mcap",),
    about=FormatAbout(
        tracks="topics of `foxglove.LocationFix` (Protocol Buffers or JSON), with covariances, headings and "
        "altitudes; in our own export also which source each is",
        objects="points of the last `foxglove.GeoJSON`",
        left_out="topics of other types",
        written_by="this program ([Foxglove](foxglove.md)), programs with Foxglove's SDK",
    ),
)
