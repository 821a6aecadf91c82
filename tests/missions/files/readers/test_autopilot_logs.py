"""Flight logs of autopilots: ULog of PX4, DataFlash and telemetry of ArduPilot."""

import io
import struct

import pytest

from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers import ardupilot, ulog
from webapp.missions.files.track_chunks import Findings, RobotPiece
from webapp.missions.files.track_reader import kind_of

START = unix_time("2026-05-01T10:00:00Z")
BOOT_US = 5_000_000
"""The autopilot's clock at that time."""

OLD = (
    "uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;"
    "float eph;uint8_t fix_type;"
)
NEW = (
    "uint64_t timestamp;uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
    "double altitude_msl_m;float eph;uint8_t fix_type;uint8_t[3] _padding0;"
)
LOCAL = "uint64_t timestamp;float[2] other;nested_t more;float x;float y;float z;float heading;bool xy_valid;"


def message(kind: str, data: bytes) -> bytes:
    return struct.pack("<HB", len(data), ord(kind)) + data


def flight(*, old: bool = True, utc: bool = True, fix: int = 3) -> bytes:
    """Return a ULog of 5 fixes and 5 estimates, one a second."""
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    data += message("F", f"vehicle_gps_position:{OLD if old else NEW}".encode())
    data += message("F", b"nested_t:uint8_t a;uint16_t[3] b;") + message("I", b"\x09char[2] axy")
    data += message("F", f"vehicle_local_position:{LOCAL}".encode())
    data += message("A", struct.pack("<BH", 0, 7) + b"vehicle_gps_position")
    data += message("A", struct.pack("<BH", 0, 9) + b"vehicle_local_position")
    data += message("A", struct.pack("<BH", 0, 11) + b"battery_status")
    for n in range(5):
        us = BOOT_US + n * 1_000_000
        utc_us = round((START + n) * 1e6) if utc else 0
        place = (501_000_000 + n, 144_000_000, 230_500) if old else (50.1 + n * 1e-7, 14.4, 230.5)
        code = "<HQQiiifB" if old else "<HQQdddfB"
        data += message("D", struct.pack(code, 7, us, utc_us, *place, 2.0, fix))
        data += message("D", struct.pack("<HQ2f7x4f?", 9, us, 1, 2, n, 2.0 * n, -3.0, 0.5, n != 4))
        data += message("D", struct.pack("<Hd", 11, 1.0))
    return data


def read(reader, data: bytes):
    findings = Findings()
    return list(reader(io.BytesIO(data), findings=findings)), findings


@pytest.mark.parametrize("old", [True, False])
def test_a_ulog_gives_fixes_and_the_estimated_way(tmp_path, old):
    path = tmp_path / "log"
    path.write_bytes(flight(old=old))
    assert kind_of(path).title == "ULog"
    (gps, local), findings = read(ulog.read, flight(old=old))
    assert gps.poses.times_s == pytest.approx([START + n for n in range(5)])
    assert gps.poses.latlon[-1] == pytest.approx([50.1 + 4e-7, 14.4], abs=1e-9)
    assert gps.poses.height_m[0] == pytest.approx(230.5)
    assert gps.poses.covariance_m2[0].tolist() == [4.0, 4.0, 0.0]
    assert isinstance(local, RobotPiece)
    assert local.poses.times_s == pytest.approx([START + n for n in range(4)])
    assert local.poses.xyz_m[1].tolist() == [1.0, -2.0, 3.0], "from north, east, down"
    assert local.poses.yaw_rad[0] == pytest.approx(-0.5)
    assert [one.reason for one in findings.skipped()] == ["estimates that the autopilot marks as invalid"]


def test_a_ulog_without_a_date_counts_from_the_start():
    (gps, _), findings = read(ulog.read, flight(utc=False))
    assert gps.poses.times_s[0] == 5.0
    assert findings.notes == ["no fix has a time: times count from the start of the autopilot"]
    pieces, findings = read(ulog.read, flight(fix=1))
    assert [piece.track for piece in pieces] == ["vehicle_local_position"]
    assert findings.skipped()[0].reason == "fixes marked invalid by the receiver"


def test_a_ulog_that_is_cut_or_damaged_is_read_to_there_or_refused():
    whole = flight()
    for end in range(16, len(whole), 7):
        pieces, _ = read(ulog.read, whole[:end])
        assert sum(len(piece.poses) for piece in pieces) <= 9
    nested = message("F", b"vehicle_gps_position:a_t a;") + message("F", b"a_t:a_t a;")
    add = message("A", struct.pack("<BH", 0, 7) + b"vehicle_gps_position")
    with pytest.raises(TrackError, match="nested more than 10 deep"):
        read(ulog.read, whole[:59] + nested + add)
    huge = message("F", b"vehicle_gps_position:uint64_t[999999999999] a;uint64_t timestamp;")
    with pytest.raises(TrackError, match="longer than 65535 bytes"):
        read(ulog.read, whole[:59] + huge + add)


def dataflash(status: int = 3) -> bytes:
    def define(id_: int, name: str, codes: str, labels: str, size: int) -> bytes:
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", id_, size + 3, *(t.encode() for t in (name, codes, labels))
        )

    body = struct.Struct("<QBBIHBhiiiffff")
    labels = "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"
    data = define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 86)
    data += define(10, "GPS", "QBBIHBcLLeffff", labels, body.size) + define(11, "IMU", "Qf", "TimeUS,Gyr", 12)
    for n in range(3):
        for instance in (0, 1):
            place = (-501_000_000 + n, 144_000_000 + instance, 23050)
            row = (n, instance, status, 468_018_000 + n * 1000, 2416, 9, 120, *place, 2.0, 90.0, 0.0, 0.0)
            data += b"\xa3\x95\x0a" + body.pack(*row)
        data += b"\xa3\x95\x0b" + struct.pack("<Qf", n, 0.5) + b"\xff\xff"[: n == 1]
    return data


def test_a_dataflash_log_has_a_track_for_each_receiver(tmp_path):
    path = tmp_path / "log"
    path.write_bytes(dataflash())
    assert kind_of(path).title == "DataFlash log"
    pieces, findings = read(ardupilot.read_dataflash, dataflash())
    assert [piece.track for piece in pieces] == ["GPS", "GPS 1"]
    poses = pieces[1].poses
    assert poses.times_s.tolist() == [START, START + 1, START + 2], "leap seconds are taken off"
    assert poses.latlon[0] == pytest.approx([-50.1, 14.4 + 1e-7])
    assert (poses.height_m[0], poses.heading_deg[0]) == (pytest.approx(230.5), 90.0)
    assert [(one.reason, one.count) for one in findings.skipped()] == [("bytes that are no message", 1)]
    assert not read(ardupilot.read_dataflash, dataflash(status=1))[0]
    for end in range(0, len(dataflash()), 11):
        read(ardupilot.read_dataflash, dataflash()[:end])


def telemetry(version: int, *, spoil: bool = False) -> bytes:
    data = b""
    for n in range(3):
        fix = struct.pack("<Qiii4HBB", n, 501_000_000 + n, 144_000_000, 230_500, 120, 90, 200, 9000, 3, 9)
        for id_, payload in ((0, bytes(9)), (24, fix)):
            if version == 1:
                packet = struct.pack("<BBBBB", len(payload), n, 5, 1, id_) + payload
            else:
                packet = (
                    struct.pack("<BBBBBB", len(payload), 0, 0, n, 5, 1) + id_.to_bytes(3, "little") + payload
                )
            check = ardupilot.checksum(packet, 24 if id_ else 50)
            mark = b"\xfe" if version == 1 else b"\xfd"
            data += round((START + n) * 1e6).to_bytes(8, "big") + mark + packet
            data += bytes(2) if spoil else check
    return data


@pytest.mark.parametrize("version", [1, 2])
def test_a_telemetry_log_has_a_track_for_each_vehicle(tmp_path, version):
    path = tmp_path / "log"
    path.write_bytes(telemetry(version))
    assert kind_of(path).title == "MAVLink telemetry log"
    (piece,), findings = read(ardupilot.read_telemetry, telemetry(version))
    assert piece.track == "vehicle 5"
    assert piece.poses.times_s.tolist() == [START, START + 1, START + 2]
    assert piece.poses.latlon[2] == pytest.approx([50.1 + 2e-7, 14.4], abs=1e-9)
    assert (piece.poses.height_m[0], piece.poses.heading_deg[0]) == (230.5, 90.0)
    assert not findings.skipped()
    pieces, findings = read(ardupilot.read_telemetry, telemetry(version, spoil=True))
    assert not pieces
    assert findings.skipped()[0].reason == "packets with a wrong checksum"
    for end in range(0, len(telemetry(version)), 13):
        read(ardupilot.read_telemetry, telemetry(version)[:end])
