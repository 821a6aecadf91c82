"""Packets of MAVLink are found, whole or in pieces, among garbage, and only with their checksum."""

import random

import pytest

from tests.connect.mavlink.vehicle import SimulatedVehicle, packet_1, packet_2
from webapp.connect.mavlink.modes import mode_name
from webapp.connect.mavlink.packets import PacketReader, command

PYMAVLINK = [
    (
        "fe09c8070100050000000203810403828e",
        0,
        {"custom_mode": 5, "type": 2, "autopilot": 3, "base_mode": 129},
    ),
    (
        "fd090100c8070100000000000404020c81040312570140e201000000cb92c1f2d227",
        0,
        {"custom_mode": 67371008, "type": 2, "autopilot": 12},
    ),
    (
        "fd1f0000c80701010000010000000200000003000000f4013831ffff0000000000000000000000004d27d1",
        1,
        {"battery_remaining": 77},
    ),
    (
        "fd0a0000c807010200004022b58be6520600e8fd7f7a",
        2,
        {"time_unix_usec": 1780000000123456, "time_boot_ms": 65000},
    ),
    (
        "fd340000c80701180000404b4c000000000041a7dc1dfebb6af7648403007800960036019411030938320400"
        "dc050000d00700000a00000014000000a08cb8a5",
        24,
        {
            "time_usec": 5000000,
            "lat": 501000001,
            "lon": -144000002,
            "alt": 230500,
            "eph": 120,
            "vel": 310,
            "cog": 4500,
            "fix_type": 3,
            "h_acc": 1500,
            "yaw": 36000,
        },
    ),
    (
        "fd100000c807011e0000e8030000cdcccc3dcdcc4c3e0000c0bf0b04",
        30,
        {"yaw": -1.5},
    ),
    (
        "fd1c0000c80701210000e8fd000041a7dc1dfebb6af764840300204e00000100020003009f8c82f7",
        33,
        {"time_boot_ms": 65000, "lat": 501000001, "lon": -144000002, "alt": 230500, "hdg": 35999},
    ),
    (
        "fd090000c807016d00000100020078c85a14159fd5",
        109,
        {"rssi": 120, "remrssi": 200},
    ),
    (
        "fd360000c807017c0000808d5b000000000041a7dc1dfebb6af764840300a00f000050005a0014006400060e"
        "052823010000000e0000001400000001000000015361",
        124,
        {
            "time_usec": 6000000,
            "lat": 501000001,
            "lon": -144000002,
            "alt": 230500,
            "eph": 80,
            "vel": 20,
            "cog": 100,
            "fix_type": 6,
            "yaw": 9000,
            "h_acc": 14,
        },
    ),
    (
        "fd240000c8070193000064000000c8000000c409681068106810681068106810681068106810681096000101012aa93f",
        147,
        {"id": 1, "battery_function": 1, "battery_remaining": 42},
    ),
    (
        "fd360000c80701fd00000450726541726d3a20436f6d70617373206e6f74206865616c746879000000000000"
        "000000000000000000000000000000000009000176bd",
        253,
        {"severity": 4, "id": 9, "chunk_seq": 1},
    ),
    (
        "fe21c807014c00000442005043480000000000000000000000000000000000000000ff01010100204a",
        76,
        {
            "param1": 33.0,
            "param2": 200000.0,
            "command": 511,
            "target_system": 1,
            "target_component": 1,
            "confirmation": 0,
        },
    ),
]
"""Packets of system 7 with number 200 as pymavlink 2.4.50 wrote them, the message, and some of its fields."""


def read(data, *, whole=True):
    reader = PacketReader()
    return list(reader.read(data, whole=whole)), reader


def flight(version=2, count=40):
    """Return the packets of a flight."""
    vehicle = SimulatedVehicle(version=version)
    made = []
    for n in range(count):
        made += [vehicle.heartbeat(), vehicle.position(1000 * n + 1), vehicle.receiver(), vehicle.text("Hi")]
    return made


@pytest.mark.parametrize(("text", "message", "fields"), PYMAVLINK)
def test_what_pymavlink_writes_is_read(text, message, fields):
    (found,), reader = read(bytes.fromhex(text))
    assert (found.message, reader.garbage, reader.damaged) == (message, 0, 0)
    assert (found.system, found.component, found.sequence) == (7, 1, 200)
    assert {name: found.fields[name] for name in fields} == fields


@pytest.mark.parametrize("version", [1, 2])
def test_pieces_of_a_stream_make_the_same_packets(version):
    made = flight(version)
    whole, reader = read(b"".join(made))
    assert (len(whole), reader.garbage, reader.damaged) == (len(made), 0, 0)
    rng, data, reader, found = random.Random(version), b"".join(made), PacketReader(), []
    while data:
        size = rng.randint(1, 40)
        found += reader.read(data[:size], whole=False)
        data = data[size:]
    assert (found, reader.garbage) == (whole, 0)


@pytest.mark.parametrize("seed", range(5))
def test_garbage_between_packets_costs_none_of_them(seed):
    rng = random.Random(seed)
    made = flight()
    noise = [bytes(rng.randrange(256) for _ in range(rng.randrange(30))) for _ in made]
    data = b"".join(part for pair in zip(noise, made, strict=True) for part in pair)
    found, reader = read(data)
    expected, _ = read(b"".join(made))
    assert [one for one in found if one in expected] == expected
    assert reader.garbage > 0


def test_a_changed_bit_loses_one_packet():
    made = flight(count=3)
    for place in range(1, len(made[5])):
        broken = bytearray(made[5])
        broken[place] ^= 4
        found, reader = read(b"".join([*made[:5], bytes(broken), *made[6:]]))
        known = [one for one in found if one.fields]
        assert len(known) == len(made) - 1, place
        assert reader.garbage > 0 or len(found) == len(made)


def test_a_datagram_that_was_cut_does_not_join_the_next():
    first, second = flight(count=1)[:2]
    reader = PacketReader()
    assert list(reader.read(first[:-4], whole=True)) == []
    assert [one.message for one in reader.read(second, whole=True)] == [33]
    assert reader.garbage == len(first) - 4


def test_signed_packets_and_messages_that_are_not_used_are_stepped_over():
    vehicle = SimulatedVehicle()
    signed = packet_2(0, bytes.fromhex("05000000020381 0403"), signed=True)
    other = packet_2(74, bytes(20) + b"\1")
    found, reader = read(signed + other + packet_1(0, bytes(9)) + vehicle.heartbeat())
    assert [one.message for one in found] == [0, 74, 0, 0]
    assert (found[0].fields["custom_mode"], found[1].fields, reader.garbage) == (5, {}, 0)


def test_a_packet_with_unknown_rules_is_left_out():
    heartbeat = bytearray(SimulatedVehicle().heartbeat())
    heartbeat[2] = 2
    assert read(bytes(heartbeat))[0] == []


@pytest.mark.parametrize("size", [1, 5, 500])
def test_noise_is_read_to_its_end(size):
    rng = random.Random(size)
    reader = PacketReader()
    for _ in range(20):
        data = bytes(rng.choice([0xFD, 0xFE, 0, 33, rng.randrange(256)]) for _ in range(size))
        assert [one for one in reader.read(data, whole=False) if one.fields] == []


def test_a_command_names_its_vehicle():
    (heartbeat,), _ = read(SimulatedVehicle(7).heartbeat())
    made = command(heartbeat, number=511, parameters=(33.0, 200_000.0), sequence=300)
    (found,), reader = read(made)
    assert (made[0], len(made), reader.damaged) == (0xFE, 41, 0)
    assert found.fields == {
        "param1": 33.0, "param2": 200_000.0, "command": 511, "target_system": 7, "target_component": 1,
        "confirmation": 0,
    }  # fmt: skip
    assert (found.system, found.sequence) == (250, 44)


MODES = [
    (3, 2, 0x81, 5, "Loiter"),
    (3, 1, 0x81, 5, "FBWA"),
    (3, 10, 0x01, 4, "Hold (disarmed)"),
    (3, 2, 0x81, 99, "mode 99"),
    (12, 2, 0x81, 4 << 16 | 4 << 24, "Mission"),
    (12, 2, 0x81, 3 << 16, "Position"),
    (12, 2, 0x81, 4 << 16, "Auto"),
    (0, 2, 0x80, 5, "mode 5"),
]


@pytest.mark.parametrize(("autopilot", "kind", "base", "custom", "name"), MODES)
def test_modes_have_the_names_of_ground_stations(autopilot, kind, base, custom, name):
    assert mode_name(autopilot=autopilot, kind=kind, base=base, custom=custom) == name
