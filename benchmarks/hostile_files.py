"""Small files with tracks that would take very much memory or time: decompression bombs and the like.

Each is built by a function of a number, the bytes or elements that it would blow up to.
"""

from __future__ import annotations

import bz2
import io
import random
import sqlite3
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from backports import zstd
from lz4 import frame as lz4

POSE = "float64 x"
"""A message definition, with which no pose can be read."""

_MAGIC = b"\x89MCAP0\r\n"
_BLOCK = 4_000_000
_KML = "<kml><Placemark><LineString><coordinates>{}</coordinates></LineString></Placemark></kml>"
_COMPRESS: Mapping[str, Callable[[bytes], bytes]] = {
    "zstd": zstd.compress,
    "lz4": lz4.compress,
    "bz2": bz2.compress,
}


def zeros(size: int, compression: str) -> bytes:
    """Return zeros, compressed as several frames."""
    compress = _COMPRESS[compression]
    return compress(bytes(_BLOCK)) * (size // _BLOCK) + compress(bytes(size % _BLOCK))


def mcap(size: int, compression: str, *, stated: int | None = None, profile: str = "ros2") -> bytes:
    """Make an MCAP with one chunk of zeros.

    Args:
        stated: Size of the chunk that the file states, instead of the true one.
        profile: Of ROS 2, or empty for a file of Foxglove.
    """
    packed = zeros(size, compression)
    chunk = struct.pack("<QQQI", 0, 0, size if stated is None else stated, 0)
    chunk += _text(compression) + struct.pack("<Q", len(packed)) + packed
    return b"".join(
        (
            _MAGIC,
            _mcap_record(1, _text(profile) + _text("")),
            _mcap_record(6, chunk),
            _mcap_record(2, bytes(20)),
            _MAGIC,
        )
    )


def ros1_bag(
    definition: str = POSE, *, size: int = 4, compression: str = "none", stated: int | None = None
) -> bytes:
    """Make a ROS 1 bag with one chunk of zeros and one connection.

    Args:
        definition: Of the messages.
        size: Bytes of the chunk.
        stated: Size of the chunk that the file states, instead of the true one.
    """
    packed = bytes(size) if compression == "none" else zeros(size, compression)
    kind = {
        "topic": b"/pose",
        "type": b"geometry_msgs/PoseStamped",
        "md5sum": b"",
        "message_definition": definition.encode(),
    }
    start = b"#ROSBAG V2.0\n"
    counts = {"conn_count": _u32(1), "chunk_count": _u32(1)}
    head_size = len(_bag_record({"op": b"\x03", "index_pos": bytes(8), **counts}))
    about = {"op": b"\x05", "compression": compression.encode()}
    chunk = _bag_record({**about, "size": _u32(size if stated is None else stated)}, packed)
    index = _bag_record({"op": b"\x04", "ver": _u32(1), "conn": _u32(0), "count": _u32(1)}, bytes(12))
    chunk_at = len(start) + head_size
    index_at = chunk_at + len(chunk) + len(index)
    times = {"start_time": bytes(8), "end_time": bytes(8)}
    place = {"op": b"\x06", "ver": _u32(1), "chunk_pos": struct.pack("<Q", chunk_at), **times}
    return b"".join(
        (
            start,
            _bag_record({"op": b"\x03", "index_pos": struct.pack("<Q", index_at), **counts}),
            chunk,
            index,
            _bag_record({"op": b"\x07", "conn": _u32(0), "topic": b"/pose"}, _bag_fields(kind)),
            _bag_record({**place, "count": _u32(1)}, _u32(0) + _u32(1)),
        )
    )


def db3(data: str = "BLOB", *, more: str = "") -> bytes:
    """Make a ROS 2 bag in SQLite with one message.

    Args:
        data: Declaration of the column with the messages.
        more: Further statements.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        opened = sqlite3.connect(path)
        opened.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
            f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data {data});"
            "INSERT INTO topics VALUES (1, '/pose', 'geometry_msgs/msg/PoseStamped', 'cdr');"
            "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1);" + more
        )
        opened.close()
        return path.read_bytes()


def computed_db3(size: int) -> bytes:
    """Make a ROS 2 bag whose message is computed by the database when it is read."""
    return db3(f"BLOB GENERATED ALWAYS AS (zeroblob({size})) VIRTUAL")


def kml(coordinates: str) -> bytes:
    """Make a KML with one line."""
    return _KML.format(coordinates).encode()


def kmz(content: bytes) -> bytes:
    """Make a KMZ."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo("doc.kml"), content, compress_type=zipfile.ZIP_DEFLATED)
    return file.getvalue()


def fit(messages: int) -> bytes:
    """Make a FIT file with messages of two bytes."""
    body = b"\x40\0\0" + struct.pack("<HB", 20, 1) + bytes((2, 1, 2)) + b"\0\1" * messages
    head = struct.pack("<2BHI4s", 12, 16, 100, len(body), b".FIT")
    return head + body + struct.pack("<H", _fit_crc(head + body))


def ulog(kind: bytes, *messages: bytes) -> bytes:
    """Make a ULog of messages of one kind, and a subscription to positions."""
    add = (b"A", b"\0\0\0vehicle_gps_position")
    parts = [
        struct.pack("<H", len(data)) + code + data for code, data in [*((kind, m) for m in messages), add]
    ]
    return b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(parts)


def tlog(garbage: int) -> bytes:
    """Make a telemetry log of two packets and bytes that are none."""
    packet = (1_777_629_600_000_000).to_bytes(8, "big") + b"\xfe\0\0\1\1\0\0\0"
    return packet * 2 + b"\xfe" * garbage


def gpx(attribute: int) -> bytes:
    """Make a GPX with one huge attribute."""
    return b'<gpx version="1.1"><trk><trkseg a="' + b"x" * attribute + b'"/></trk></gpx>'


def nested(depth: int) -> bytes:
    """Make a GPX with nested elements."""
    return b'<gpx version="1.1">' + b"<a>" * depth + b"</a>" * depth + b"</gpx>"


BOMBS: Mapping[str, Callable[[int], tuple[str, bytes]]] = {
    "array in a definition": lambda size: ("a.bag", ros1_bag(f"string[{size}] x")),
    "mcap zstd": lambda size: ("a.mcap", mcap(size, "zstd")),
    "mcap lz4": lambda size: ("a.mcap", mcap(min(size, 500_000_000), "lz4")),
    "foxglove zstd": lambda size: ("a.mcap", mcap(size, "zstd", profile="")),
    "foxglove empty": lambda size: ("a.mcap", mcap(min(size, 12_000_000), "zstd", profile="")),
    "mcap that lies": lambda size: ("a.mcap", mcap(size, "zstd", stated=1000)),
    "bag bz2": lambda size: ("a.bag", ros1_bag(size=size, compression="bz2")),
    "bag lz4 that lies": lambda size: (
        "a.bag",
        ros1_bag(size=min(size, 500_000_000), compression="lz4", stated=1000),
    ),
    "computed column": lambda size: ("a.db3", computed_db3(size)),
    "view": lambda _size: ("a.db3", db3(more="CREATE VIEW v AS SELECT zeroblob(900000000);")),
    "kmz": lambda size: ("a.kmz", kmz(kml("1,1 " * (size // 300)))),
    "blanks": lambda size: ("a.kml", kml(" " * min(size // 100, 3_000_000))),
    "positions": lambda size: ("a.kml", kml("1,1 " * min(size // 100, 900_000))),
    "fit": lambda size: ("a.fit", fit(min(size // 3000, 100_000))),
    "ulog nested": lambda _size: ("a.ulg", ulog(b"F", b"vehicle_gps_position:a_t a;", b"a_t:a_t[9999] a;")),
    "ulog empty": lambda size: ("a.ulg", ulog(b"I", *[b""] * min(size // 100, 1_000_000))),
    "dataflash": lambda size: (
        "a.bin",
        b"\xa3\x95\x80" + bytes(86) + b"\xa3\x95\1" * min(size // 100, 3_000_000),
    ),
    "tlog": lambda size: ("a.tlog", tlog(min(size // 100, 5_000_000))),
    "attribute": lambda size: ("a.gpx", gpx(min(size // 100, 3_000_000))),
    "nested": lambda size: ("a.gpx", nested(min(size // 1000, 500_000))),
}
"""Makes the name and content of a file, by its kind."""


def bomb(chance: random.Random) -> tuple[str, bytes]:
    """Make one of these files at random; return its name and content."""
    return _made(chance.choice(sorted(BOMBS)), chance.choice((30_000_000, 500_000_000)))


@cache
def _made(kind: str, size: int) -> tuple[str, bytes]:
    return BOMBS[kind](size)


def _text(text: str) -> bytes:
    return _u32(len(text)) + text.encode()


def _u32(number: int) -> bytes:
    return struct.pack("<I", number)


def _mcap_record(code: int, data: bytes) -> bytes:
    return bytes([code]) + struct.pack("<Q", len(data)) + data


def _bag_fields(fields: Mapping[str, bytes]) -> bytes:
    return b"".join(
        _u32(len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )


def _bag_record(fields: Mapping[str, bytes], data: bytes = b"") -> bytes:
    head = _bag_fields(fields)
    return _u32(len(head)) + head + _u32(len(data)) + data


def _fit_crc(data: bytes) -> int:
    """Return the checksum of FIT, CRC-16 with the polynomial 0xA001."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc
