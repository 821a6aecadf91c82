"""Reads positions from the telemetry of GoPro cameras (GPMF: https://github.com/gopro/gpmf-parser).

A packet is a tree of key, length and value: four letters, a type, the size of a sample, their number, and the
samples, padded to four bytes. A stream holds one sensor; what describes its samples precedes them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import NamedTuple

from webapp.core.geo.types import LatLon

_HEADER = struct.Struct(">4sBBH")
_OF_TYPE = {
    "b": "b",
    "B": "B",
    "s": "h",
    "S": "H",
    "l": "i",
    "L": "I",
    "f": "f",
    "d": "d",
    "j": "q",
    "J": "Q",
}
"""Letters of `struct` for those of GPMF."""

_LEAST_FIX = 2
"""2: in the plane, 3: in space."""

_DEEPEST = 8


class GpmfError(Exception):
    """The telemetry is damaged."""


class _Item(NamedTuple):
    key: str
    type: str
    size: int
    repeat: int
    value: bytes


def is_telemetry(packet: bytes) -> bool:
    """Recognise a packet by its first key."""
    return packet.startswith(b"DEVC")


def read_positions(packet: bytes) -> list[LatLon]:
    """Return the positions in a packet, in order of time; those without a fix are NaN. Raises GpmfError."""
    return list(_positions(packet, depth=0))


def _positions(data: bytes, *, depth: int) -> Iterator[LatLon]:
    if depth > _DEEPEST:
        raise GpmfError("it is nested too deeply")
    scale: list[float] = []
    types, fix = "", 3
    for item in _items(data):
        if item.type == "\0":
            yield from _positions(item.value, depth=depth + 1)
        elif item.key == "SCAL":
            scale = [row[0] for row in _samples(item, item.type)]
        elif item.key == "TYPE":
            types = item.value.decode("ascii", "replace").rstrip("\0")
        elif item.key == "GPSF":
            fix = int(next((row[0] for row in _samples(item, item.type)), 0))
        elif item.key in ("GPS5", "GPS9"):
            letters = item.type * 5 if item.key == "GPS5" else types
            for row in _samples(item, letters):
                # GPS9 has the fix of each sample in its last column
                yield _position(row, scale, fix=int(row[8]) if len(row) > 8 else fix)


def _position(row: tuple[float, ...], scale: list[float], *, fix: int) -> LatLon:
    lat_scale, lon_scale = scale[:2] if len(scale) > 1 else (scale or [1.0]) * 2
    if fix < _LEAST_FIX or not lat_scale or not lon_scale:
        return LatLon(math.nan, math.nan)
    lat, lon = row[0] / lat_scale, row[1] / lon_scale
    inside = abs(lat) <= 90.0 and abs(lon) <= 180.0
    return LatLon(lat, lon) if inside else LatLon(math.nan, math.nan)


def _items(data: bytes) -> Iterator[_Item]:
    at = 0
    while at + _HEADER.size <= len(data):
        key, kind, size, repeat = _HEADER.unpack_from(data, at)
        if key == b"\0\0\0\0":
            return  # padding
        length = size * repeat
        value = data[at + _HEADER.size : at + _HEADER.size + length]
        if len(value) < length:
            raise GpmfError(f"{key.decode('ascii', 'replace')} ends before its last sample")
        yield _Item(key.decode("ascii", "replace"), chr(kind), size, repeat, value)
        at += _HEADER.size + (length + 3) // 4 * 4


def _samples(item: _Item, letters: str) -> Iterator[tuple[float, ...]]:
    try:
        row = struct.Struct(">" + "".join(_OF_TYPE[letter] for letter in letters))
    except KeyError as error:
        raise GpmfError(f"{item.key} has a type that is not known") from error
    if not row.size or len(item.value) % row.size:
        raise GpmfError(f"{item.key} has samples of another size than its type")
    yield from row.iter_unpack(item.value)
