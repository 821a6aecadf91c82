"""A simulated vehicle: packets of MAVLink, written from its specification."""

import struct

EXTRA = {0: 50, 1: 124, 2: 137, 24: 24, 30: 39, 33: 104, 76: 152, 109: 185, 124: 87, 147: 154, 253: 83}
"""The constant of each message that its checksum takes in (`CRC_EXTRA`)."""

COPTER, PX4, ARDUPILOT = 2, 12, 3


def crc(data):
    """CRC-16/MCRF4XX, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return struct.pack("<H", value)


def packet_1(message, payload, *, sequence=0, system=1, component=1):
    """Return a packet of version 1."""
    inner = bytes([len(payload), sequence, system, component, message]) + payload
    return b"\xfe" + inner + crc(inner + bytes([EXTRA[message]]))


def packet_2(message, payload, *, sequence=0, system=1, component=1, signed=False):
    """Return a packet of version 2: without the zeros at its end."""
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), int(signed), 0, sequence, system, component])
    inner = head + message.to_bytes(3, "little") + payload
    signature = bytes([1]) + bytes(12) if signed else b""
    return b"\xfd" + inner + crc(inner + bytes([EXTRA.get(message, 0)])) + signature


class SimulatedVehicle:
    """Makes the packets of a vehicle, numbered."""

    def __init__(self, system=1, *, kind=COPTER, autopilot=ARDUPILOT, version=2):
        self.system, self.kind, self.autopilot = system, kind, autopilot
        self.packet = packet_2 if version == 2 else packet_1
        self.sequence = 0

    def make(self, message, payload, **more):
        """Return a packet, and count it."""
        found = self.packet(message, payload, **{"sequence": self.sequence, "system": self.system, **more})
        self.sequence = (self.sequence + 1) % 256
        return found

    def heartbeat(self, custom=5, *, base=0x81, **more):
        return self.make(0, struct.pack("<I5B", custom, self.kind, self.autopilot, base, 4, 3), **more)

    def position(self, boot_ms, lat=50.1, lon=14.4, *, height_m=230.5, heading_deg=90.0):
        hdg = 65_535 if heading_deg is None else round(heading_deg * 100)
        place = (round(lat * 1e7), round(lon * 1e7), round(height_m * 1e3), 20_000)
        return self.make(33, struct.pack("<I4i3hH", boot_ms, *place, 0, 0, 0, hdg))

    def receiver(
        self, fix=3, *, accuracy_mm=1500, hdop=1.2, time_us=0, lat=50.1, lon=14.4, course=0, speed=0
    ):
        place = (round(lat * 1e7), round(lon * 1e7), 230_500)
        base = struct.pack("<Q3i4H2B", time_us, *place, round(hdop * 100), 65_535, speed, course, fix, 9)
        extension = struct.pack("<i4IH", 0, accuracy_mm, 0, 0, 0, 0)
        return self.make(24, base + (extension if self.packet is packet_2 else b""))

    def second_receiver(self, fix=3, *, accuracy_mm=20, yaw=0, time_us=0, lat=50.1, lon=14.4):
        place = (round(lat * 1e7), round(lon * 1e7), 230_500)
        base = struct.pack("<Q3iI4H3B", time_us, *place, 0, 120, 65_535, 0, 0, fix, 9, 0)
        return self.make(124, base + struct.pack("<Hi4I", yaw, 0, accuracy_mm, 0, 0, 0))

    def clock(self, unix_s, boot_ms):
        return self.make(2, struct.pack("<QI", round(unix_s * 1e6), boot_ms))

    def attitude(self, yaw_rad):
        return self.make(30, struct.pack("<I6f", 0, 0, 0, yaw_rad, 0, 0, 0))

    def charge(self, percent):
        return self.make(1, struct.pack("<3I2Hh6Hb", 0, 0, 0, 0, 12_000, 0, 0, 0, 0, 0, 0, 0, percent))

    def battery(self, percent, *, number=0, function=1):
        cells = [65_535] * 10
        return self.make(147, struct.pack("<2ih10Hh3Bb", 0, 0, 0, *cells, 0, number, function, 1, percent))

    def text(self, said, severity=6, *, number=0, piece=0):
        more = struct.pack("<HB", number, piece) if self.packet is packet_2 else b""
        return self.make(253, struct.pack("<B50s", severity, said.encode()) + more)


def radio(rssi, remote, *, system=51, component=68):
    """Return the packet of a telemetry radio."""
    return packet_2(
        109, struct.pack("<2H5B", 0, 0, rssi, remote, 100, 20, 20), system=system, component=component
    )
