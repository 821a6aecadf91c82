"""Receives events of a TAK server by TCP or TLS, or of a multicast group or port by UDP."""

from __future__ import annotations

import contextlib
import ipaddress
import math
import socket
import struct
import time
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

from webapp.connect.tak.events import MESH_HEADER, UNKNOWN_M, CotEvent, to_xml
from webapp.connect.tak.link import datagram_address, failure, open_stream, parsed
from webapp.core.geo.types import LatLon
from webapp.errors import InputError, TrackError
from webapp.files.exchange.times import unix_time
from webapp.files.exchange.xml import local_name, number, walk

EVERY_S = 1.0
_PING_S = 30.0
_MOST_BYTES = 1 << 20
"""Maximum size of one event; those of ATAK with drawings stay below 100 kB."""
_MOST_DATAGRAMS = 1000
"""Maximum number of datagrams at once; the system drops what comes faster than they are stored."""
_END = b"</event>"


class TakFeed:
    """An open connection that events come from.

    Args:
        address, certificate, authority, interface: As for `TakLink`; by UDP the address to listen on: a
            multicast group, or an address of this computer.

    Raises:
        UsageError: The address or the options cannot work.
        InputError: The server does not answer, or the port is taken.
    """

    def __init__(
        self,
        address: str,
        *,
        certificate: Path | None = None,
        authority: Path | None = None,
        interface: str | None = None,
    ) -> None:
        scheme, host, port = parsed(address, secured=bool(certificate or authority))
        self._address, self._is_stream = address, scheme != "udp"
        self.unreadable = 0  # Events that are neither XML nor protobuf of version 1
        try:
            if self._is_stream:
                self._socket = open_stream(
                    host, port, secured=scheme == "tls", certificate=certificate, authority=authority
                )
            else:
                self._socket = _listening(host, port, interface)
        except OSError as error:
            raise failure(error, what="cannot receive", address=address) from error

    def __enter__(self) -> TakFeed:
        """Return the feed itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection."""
        self._socket.close()

    def batches(self) -> Iterator[list[CotEvent]]:
        """Yield the events of each second, also none; raises InputError if the connection is lost."""
        rest, pinged = b"", 0.0
        while True:
            if self._is_stream:
                if time.monotonic() - pinged > _PING_S:
                    self._ping()
                    pinged = time.monotonic()
                *messages, rest = (rest + self._stream()).split(_END)
                if len(rest) > _MOST_BYTES:
                    raise InputError("an event has no end", where=self._address, hint="is it a TAK server?")
                messages = [message + _END for message in messages]
            else:
                messages = self._datagrams()
            yield list(self._read(messages))

    def _read(self, messages: list[bytes]) -> Iterator[CotEvent]:
        for message in messages:
            try:
                is_protobuf = message.startswith(MESH_HEADER)
                yield from_protobuf(message[len(MESH_HEADER) :]) if is_protobuf else from_xml(message)
            except TrackError:
                self.unreadable += 1

    def _ping(self) -> None:
        """Send what servers expect of clients that have nothing to say."""
        now, nowhere = time.time(), LatLon(0.0, 0.0)
        ping = CotEvent("expmap-ping", "t-x-c-t", "m-g", "", nowhere, now, now, now + _PING_S)
        try:
            self._socket.sendall(to_xml(ping))
        except OSError as error:
            raise failure(error, what="the connection was lost", address=self._address) from error

    def _stream(self) -> bytes:
        parts: list[bytes] = []
        for part in self._received():
            if not part and not parts:
                raise InputError("the server closed the connection", where=self._address)
            if not part or sum(map(len, parts)) > _MOST_BYTES:
                break
            parts.append(part)
        return b"".join(parts)

    def _datagrams(self) -> list[bytes]:
        found: list[bytes] = []
        for data in islice(self._received(), _MOST_DATAGRAMS):
            found.append(data)
            if sum(map(len, found)) > _MOST_BYTES:
                break
        return found

    def _received(self) -> Iterator[bytes]:
        until = time.monotonic() + EVERY_S
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                yield self._socket.recv(1 << 16)
            except TimeoutError:
                return
            except OSError as error:
                raise failure(error, what="the connection was lost", address=self._address) from error


def _listening(host: str, port: int, interface: str | None) -> socket.socket:
    family, _, _, _, found = datagram_address(host, port)
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(found)
        group = ipaddress.ip_address(found[0])
        if group.is_multicast and group.version == 4:
            member = group.packed + socket.inet_aton(interface or "0.0.0.0")
            made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        elif group.is_multicast:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group.packed + struct.pack("@I", 0))
    except OSError:
        made.close()
        raise
    return made


def from_xml(data: bytes) -> CotEvent:
    """Read an event from XML; raises TrackError if it is damaged or has no position and time."""
    for happened, found in walk(BytesIO(data.strip()), whole=("event",)):
        if happened == "end" and local_name(found) == "event":
            return _event(found)
    raise TrackError("it is no event of Cursor-on-Target")


def _event(found: Element) -> CotEvent:
    point = _child(found, "point")
    detail = _child(found, "detail")
    course = number(_child(detail, "track").get("course"))
    times = [unix_time(found.get(name, "")) for name in ("time", "start", "stale")]
    return _checked(
        {name: found.get(name, "") for name in ("uid", "type", "how")},
        callsign=_child(detail, "contact").get("callsign", ""),
        times_s=times,
        numbers=[number(point.get(name)) for name in ("lat", "lon", "hae", "ce")],
        course_deg=course,
        remarks=(_child(detail, "remarks").text or "").strip(),
    )


def _child(parent: Element, name: str) -> Element:
    return next((child for child in parent if local_name(child) == name), Element("none"))


def _checked(
    names: dict[str, str],
    *,
    callsign: str,
    times_s: list[float],
    numbers: list[float],
    course_deg: float,
    remarks: str,
) -> CotEvent:
    lat, lon, height_m, radius_m = numbers
    if not (names["uid"] and names["type"] and abs(lat) <= 90 and abs(lon) <= 180):
        raise TrackError("the event has no identity or no position")
    if not all(map(math.isfinite, times_s)):
        raise TrackError("the event has no time")
    return CotEvent(
        uid=names["uid"],
        type=names["type"],
        how=names["how"],
        callsign=callsign,
        latlon=LatLon(lat, lon),
        time_s=times_s[0],
        start_s=times_s[1],
        stale_s=times_s[2],
        height_m=height_m if abs(height_m) < UNKNOWN_M else UNKNOWN_M,
        radius_m=radius_m if 0 <= radius_m < UNKNOWN_M else UNKNOWN_M,
        course_deg=course_deg if math.isfinite(course_deg) else None,
        remarks=remarks,
    )


def from_protobuf(data: bytes) -> CotEvent:
    """Read a `TakMessage` of version 1; raises TrackError as `from_xml` does."""
    event = _fields(_message(_fields(data), 2))
    detail = _fields(_message(event, 15))
    contact, track = _fields(_message(detail, 2)), _fields(_message(detail, 7))
    remarks = ""
    with contextlib.suppress(TrackError):  # what is no XML is no remark
        for _, found in walk(BytesIO(b"<d>" + _message(detail, 1) + b"</d>"), whole=("remarks",)):
            if local_name(found) == "remarks":
                remarks = (found.text or "").strip()
    numbers = [_number(event, field) for field in (10, 11, 12, 13)]
    return _checked(
        {name: _text(event, field) for name, field in (("uid", 5), ("type", 1), ("how", 9))},
        callsign=_text(contact, 2),
        times_s=[_whole(event, field) / 1000.0 for field in (6, 7, 8)],
        numbers=numbers,
        course_deg=_number(track, 2) if track else math.nan,
        remarks=remarks,
    )


_Fields = dict[int, bytes | int | float]


def _fields(data: bytes) -> _Fields:
    """Read the fields of a message of Protocol Buffers; of repeated ones, the last."""
    found: _Fields = {}
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            found[tag >> 3], at = _varint(data, at)
            continue
        size, at = _varint(data, at) if kind == 2 else ({1: 8, 5: 4}.get(kind, 0), at)
        if kind not in (1, 2, 5) or at + size > len(data):
            raise TrackError("the message is damaged")
        value = data[at : at + size]
        found[tag >> 3] = value if kind == 2 else struct.unpack("<d" if kind == 1 else "<f", value)[0]
        at += size
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for place, byte in enumerate(data[at : at + 10]):
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    raise TrackError("the message is damaged")


def _message(fields: _Fields, field: int) -> bytes:
    value = fields.get(field, b"")
    return value if isinstance(value, bytes) else b""


def _text(fields: _Fields, field: int) -> str:
    return _message(fields, field).decode("utf-8", "replace")


def _whole(fields: _Fields, field: int) -> float:
    value = fields.get(field, 0)
    return value if isinstance(value, int) else math.nan


def _number(fields: _Fields, field: int) -> float:
    value = fields.get(field, 0.0)  # protobuf leaves out zeros
    return value if isinstance(value, float) else math.nan
