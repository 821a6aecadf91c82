"""MCAP files of Foxglove: our own export, those of other programs, and damaged ones."""

import io
import json
import math
import struct

import numpy as np
import pytest

from webapp.core.geo.types import LatLon
from webapp.errors import TrackError
from webapp.missions.files.readers import foxglove_mcap
from webapp.missions.files.track_chunks import Findings, WorldObjects, WorldPiece
from webapp.missions.files.track_reader import kind_of
from webapp.render.foxglove import FoxglovePoint, FoxgloveSink

MAGIC = b"\x89MCAP0\r\n"
OBJECT = {
    "type": "Feature",
    "id": "door-1",
    "geometry": {"type": "Point", "coordinates": [14.5, 50.2, 230.0]},
    "properties": {"class": "door", "confidence": 0.5, "last_time": "2024-05-01T10:00:00Z", "state": "found"},
}
LINE = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[14, 50], [14, 51]]}}


def read(data):
    findings = Findings()
    return list(foxglove_mcap.read(io.BytesIO(data), findings=findings)), findings


def shapes(*features):
    return json.dumps({"type": "FeatureCollection", "features": features})


@pytest.fixture
def exported(tmp_path):
    """Our own export: a receiver's track with all that is known, odometry with a position only, an object."""
    path = tmp_path / "a.mcap"
    with FoxgloveSink(out=path) as sink:
        for n in range(3):
            place = LatLon(50.0 + n * 1e-4, 14.0)
            known = {"covariance_m2": (4.0, 9.0, 1.0), "heading_deg": 90.0, "height_m": 230.5}
            sink.point("/tracks/gps/front left", FoxglovePoint(place, (1, 2, 3), **known), time_s=1.5e9 + n)
            sink.point("/tracks/odometry", FoxglovePoint(place, (1, 2, 3)), time_s=1.5e9 + n)
        sink.shapes("/mission", shapes(LINE), time_s=1.5e9)
        sink.shapes("/mission", shapes(LINE, OBJECT), time_s=1.5e9 + 2)
        sink.values("/answer", {"a": 1}, time_s=1.5e9)
    return path.read_bytes()


def test_our_own_export_is_read_back(exported, tmp_path):
    assert kind_of(tmp_path / "a.mcap").name == "foxglove"
    pieces, findings = read(exported)
    tracks = {piece.track: piece for piece in pieces if isinstance(piece, WorldPiece)}
    assert {name: track.source for name, track in tracks.items()} == {"front left": "gps", "": "odometry"}
    full, bare = tracks["front left"].poses, tracks[""].poses
    assert full.times_s.tolist() == [1.5e9, 1.5e9 + 1, 1.5e9 + 2]
    assert full.latlon[:, 0] == pytest.approx([50.0, 50.0001, 50.0002])
    assert full.covariance_m2.tolist() == [[4.0, 9.0, 1.0]] * 3
    assert full.heading_deg.tolist() == [90.0] * 3 and full.height_m.tolist() == [230.5] * 3
    assert np.isnan(bare.covariance_m2).all() and np.isnan(bare.heading_deg).all()
    (seen,) = [one for piece in pieces if isinstance(piece, WorldObjects) for one in piece.sightings]
    assert (seen.object_id, seen.kind, seen.state, seen.latlon) == ("door-1", "door", "found", (50.2, 14.5))
    assert [(one.where, one.count) for one in findings.skipped()] == [("/answer", 1)]


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def record(code, data):
    return struct.pack("<BQ", code, len(data)) + data


def other(*messages, profile="", name="foxglove.LocationFix", encoding="json", end=True):
    """An MCAP without chunks, with messages of one topic."""
    data = MAGIC + record(1, text(profile) + text("other"))
    data += record(3, struct.pack("<H", 1) + text(name) + text("jsonschema") + text("{}"))
    data += record(4, struct.pack("<HH", 7, 1) + text("/gps") + text(encoding) + struct.pack("<I", 0))
    for n, message in enumerate(messages):
        at_ns = (1_600_000_000 + n) * 10**9
        data += record(5, struct.pack("<HIQQ", 7, n, at_ns, at_ns) + message)
    return data + (record(15, bytes(4)) + record(2, bytes(20)) + MAGIC if end else b"")


def test_fixes_in_json_of_another_program():
    with_time = {
        "latitude": 50.1,
        "longitude": 14.4,
        "timestamp": {"sec": 1_700_000_000, "nsec": 500_000_000},
    }
    without = {"latitude": 50.2, "longitude": 14.4, "position_covariance_type": 0}
    (piece,), _ = read(other(json.dumps(with_time).encode(), json.dumps(without).encode()))
    assert (piece.track, piece.source) == ("/gps", "gps")
    assert piece.poses.times_s.tolist() == [1_700_000_000.5, 1_600_000_001.0]
    assert piece.poses.latlon.tolist() == [[50.1, 14.4], [50.2, 14.4]]
    assert math.isnan(piece.poses.height_m[0])


def test_a_file_that_is_cut_off_is_read_up_to_there():
    fix = json.dumps({"latitude": 50.1, "longitude": 14.4}).encode()
    (piece,), findings = read(other(fix, fix, end=False)[:-5])
    assert len(piece.poses) == 1
    assert "the recording was cut off: what is before that was read" in findings.notes


@pytest.mark.parametrize(
    "message", [b"{", b'"text"', b'{"latitude": "north"}', b'{"latitude": [1]}', b"[" * 100_000]
)
def test_damaged_messages_are_counted(message):
    fix = json.dumps({"latitude": 50.1, "longitude": 14.4}).encode()
    pieces, findings = read(other(message, fix))
    assert [len(piece.poses) for piece in pieces] == [1]
    assert [one.count for one in findings.skipped()] == [1]


@pytest.mark.parametrize(
    "message", [b"\x09\x00", b"\xff" * 20, b"\x22\xff\x01", b"\x0b", b"\x32\x02\x08\xff"]
)
def test_damaged_protocol_buffers_are_counted(message):
    fix = b"\x09" + struct.pack("<d", 50.1) + b"\x11" + struct.pack("<d", 14.4)
    pieces, findings = read(other(message, fix, encoding="protobuf"))
    assert [len(piece.poses) for piece in pieces] == [1]
    assert pieces[0].poses.latlon.tolist() == [[50.1, 14.4]]
    assert [one.count for one in findings.skipped()] == [1]


def test_other_topics_are_refused_by_a_sentence():
    with pytest.raises(TrackError, match=r"no messages of foxglove\.LocationFix"):
        read(other(b"{}", name="foxglove.Log"))


def test_recordings_of_ros_are_left_to_the_reader_of_bags(tmp_path):
    (tmp_path / "a").write_bytes(other(profile="ros2"))
    assert kind_of(tmp_path / "a").name == "ros2-mcap"
