"""Packets of MAVLink 1 and 2, found in bytes that arrive in pieces.

Framing and the layout of messages: https://mavlink.io/en/guide/serialization.html and, there, `common.xml`.
Signatures are not verified.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from webapp.missions.files.readers.ardupilot import checksum

HEARTBEAT, SYS_STATUS, SYSTEM_TIME, GPS_RAW_INT, ATTITUDE = 0, 1, 2, 24, 30
GLOBAL_POSITION_INT, COMMAND_LONG, RADIO_STATUS, GPS2_RAW, BATTERY_STATUS, STATUSTEXT = (
    33, 76, 109, 124, 147, 253
)  # fmt: skip

_V1, _V2 = 0xFE, 0xFD
_MARKS = (_V1, _V2)
_SIGNED = 1
_SIGNATURE = 13
_OWN_SYSTEM, _OWN_COMPONENT = 250, 191
"""This program as a sender: no ground station, or a vehicle would not notice that its own is lost."""


class Packet(NamedTuple):
    """A packet; of a message that is not in `_LAYOUTS` there are no fields, and its checksum is unknown."""

    system: int
    component: int
    sequence: int  # 0 to 255, counted by the sender
    message: int
    fields: Mapping[str, Any]


class _Layout(NamedTuple):
    """The payload of a message: in the order on the wire, with the extensions that are used."""

    extra: int
    body: struct.Struct
    names: tuple[str, ...]


def _layout(extra: int, fields: str) -> _Layout:
    """Make a layout of `CODE=NAME` or, for what is not used, `4x`."""
    parts = [part.partition("=") for part in fields.split()]
    names = tuple(name for _, _, name in parts if name)
    return _Layout(extra, struct.Struct("<" + "".join(code for code, _, _ in parts)), names)


_LAYOUTS = {
    HEARTBEAT: _layout(50, "I=custom_mode B=type B=autopilot B=base_mode 2x"),
    SYS_STATUS: _layout(124, "30x b=battery_remaining"),
    SYSTEM_TIME: _layout(137, "Q=time_unix_usec I=time_boot_ms"),
    GPS_RAW_INT: _layout(
        24, "Q=time_usec i=lat i=lon i=alt H=eph 2x H=vel H=cog B=fix_type 5x I=h_acc 12x H=yaw"
    ),
    ATTITUDE: _layout(39, "12x f=yaw 12x"),
    GLOBAL_POSITION_INT: _layout(104, "I=time_boot_ms i=lat i=lon i=alt 10x H=hdg"),
    COMMAND_LONG: _layout(
        152, "f=param1 f=param2 20x H=command B=target_system B=target_component B=confirmation"
    ),
    RADIO_STATUS: _layout(185, "4x B=rssi B=remrssi 3x"),
    GPS2_RAW: _layout(
        87, "Q=time_usec i=lat i=lon i=alt 4x H=eph 2x H=vel H=cog B=fix_type 2x H=yaw 4x I=h_acc"
    ),
    BATTERY_STATUS: _layout(154, "32x B=id B=battery_function B=type b=battery_remaining"),
    STATUSTEXT: _layout(83, "B=severity 50s=text H=id B=chunk_seq"),
}


class PacketReader:
    """Finds packets, and begins anew at the next byte where there is none."""

    def __init__(self) -> None:
        self._rest = b""
        self.garbage = 0  # Bytes that belong to no packet
        self.damaged = 0  # Packets with a wrong checksum

    def read(self, data: bytes, *, whole: bool) -> Iterator[Packet]:
        """Yield the packets that are complete.

        Args:
            whole: Whether no packet continues after the data, as in a datagram; otherwise the rest is kept.
        """
        data, at = self._rest + data, 0
        self._rest = b""
        while at < len(data):
            size = _packet_size(data, at)
            if size is None or at + size > len(data):
                if size is not None and not whole:
                    break
                self.garbage += 1
                at += 1
                continue
            packet = self._packet(data, at, size)
            if packet is None:
                self.garbage += 1
                at += 1
            else:
                at += size
                yield packet
        self._rest = data[at:]

    def _packet(self, data: bytes, at: int, size: int) -> Packet | None:
        is_v2, length = data[at] == _V2, data[at + 1]
        head = 10 if is_v2 else 6
        sequence, system, component = data[at + head - 6 : at + head - 3] if is_v2 else data[at + 2 : at + 5]
        message = int.from_bytes(
            data[at + head - 3 : at + head] if is_v2 else data[at + 5 : at + 6], "little"
        )
        layout, end = _LAYOUTS.get(message), at + head + length
        if layout is None:
            # Its checksum needs a constant of the message; a packet is followed by another, or by nothing
            known = at + size == len(data) or data[at + size] in _MARKS
            return Packet(system, component, sequence, message, {}) if known else None
        if checksum(data[at + 1 : end], layout.extra) != data[end : end + 2]:
            self.damaged += 1
            return None
        # MAVLink 2 leaves out zeros at the end, MAVLink 1 all extensions; newer ones are not known here
        body = data[at + head : end][: layout.body.size].ljust(layout.body.size, b"\0")
        fields = dict(zip(layout.names, layout.body.unpack(body), strict=True))
        return Packet(system, component, sequence, message, fields)


def _packet_size(data: bytes, at: int) -> int | None:
    """Return the size of the packet at a byte, as far as its head is there; None if there is none."""
    if data[at] == _V1:
        return 8 + data[at + 1] if at + 1 < len(data) else 8
    if data[at] != _V2 or (at + 2 < len(data) and data[at + 2] & ~_SIGNED):
        return None
    if at + 2 >= len(data):
        return 12
    return 12 + data[at + 1] + (_SIGNATURE if data[at + 2] & _SIGNED else 0)


def command(packet: Packet, *, number: int, parameters: tuple[float, float], sequence: int) -> bytes:
    """Make the packet of a command to the sender of another packet.

    Args:
        number: Of `MAV_CMD`.
        parameters: The first two.
    """
    layout = _LAYOUTS[COMMAND_LONG]
    body = layout.body.pack(*parameters, number, packet.system, packet.component, 0)
    head = bytes([len(body), sequence % 256, _OWN_SYSTEM, _OWN_COMPONENT, COMMAND_LONG])
    return bytes([_V1]) + head + body + checksum(head + body, layout.extra)
