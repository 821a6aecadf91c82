"""Cursor-on-Target events, as XML and as version 1 of the TAK protocol."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from webapp.core.geo.types import LatLon
from webapp.files.exchange.times import utc
from webapp.files.exchange.xml import element, quoted

UNKNOWN_M = 9_999_999.0
"""Cursor-on-Target's value of an unknown height or error."""

MESH_HEADER = b"\xbf\x01\xbf"
"""Begins a datagram with a message of version 1."""


@dataclass(frozen=True, slots=True)
class CotEvent:
    """One item on the map of a TAK program; a later event with the same `uid` replaces it."""

    uid: str
    type: str  # Such as `a-f-G` (friendly, on the ground) or `b-m-p-s-m` (a spot)
    how: str  # How the position was obtained: `m-g` by GPS, `h-e` entered by a person ..
    callsign: str  # Its label
    latlon: LatLon
    # Seconds since 1970, UTC: when the event was made, since when it holds, and until when.
    time_s: float
    start_s: float
    stale_s: float
    height_m: float = UNKNOWN_M  # Above the ellipsoid
    radius_m: float = UNKNOWN_M  # Circular error, `ce`
    course_deg: float | None = None
    remarks: str = ""


def to_xml(event: CotEvent) -> bytes:
    """Write an event as XML; characters that XML does not allow become question marks."""
    made, start, stale = (f"{time[:-4]}Z" for time in utc([event.time_s, event.start_s, event.stale_s]))
    point = (
        f'<point lat="{event.latlon.lat:.9f}" lon="{event.latlon.lon:.9f}" hae="{event.height_m:.3f}" '
        f'ce="{event.radius_m:.3f}" le="{UNKNOWN_M:.3f}"/>'
    )
    course = "" if event.course_deg is None else f'<track course="{event.course_deg:.3f}" speed="0"/>'
    detail = f"<contact callsign={quoted(event.callsign)}/>{course}{element('remarks', event.remarks)}"
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<event version="2.0" uid={quoted(event.uid)} '
        f'type="{event.type}" how="{event.how}" time="{made}" start="{start}" stale="{stale}">'
        f"{point}<detail>{detail}</detail></event>\n"
    ).encode()


def to_protobuf(event: CotEvent) -> bytes:
    """Write an event as a `TakMessage` of version 1, without the header of a datagram or stream."""
    detail = _bytes(1, element("remarks", event.remarks).encode()) + _bytes(2, _text(2, event.callsign))
    if event.course_deg is not None:
        detail += _bytes(7, _double(2, event.course_deg))
    cot = _text(1, event.type) + _text(5, event.uid)
    for field, time_s in enumerate((event.time_s, event.start_s, event.stale_s), start=6):
        cot += _varint(field << 3) + _varint(round(time_s * 1000.0))
    cot += _text(9, event.how)
    numbers = (*event.latlon, event.height_m, event.radius_m, UNKNOWN_M)
    for field, number in enumerate(numbers, start=10):
        cot += _double(field, number)
    return _bytes(2, cot + _bytes(15, detail))


def to_stream(event: CotEvent) -> bytes:
    """Write an event for a stream of version 1: header, length, message."""
    message = to_protobuf(event)
    return MESH_HEADER[:1] + _varint(len(message)) + message


def _varint(value: int) -> bytes:
    return bytes(_sevens(value))


def _sevens(value: int) -> Iterator[int]:
    while value > 0x7F:
        yield value & 0x7F | 0x80
        value >>= 7
    yield value


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _text(field: int, value: str) -> bytes:
    return _bytes(field, value.encode("utf-8", "replace"))


def _double(field: int, value: float) -> bytes:
    return _varint(field << 3 | 1) + struct.pack("<d", value)
