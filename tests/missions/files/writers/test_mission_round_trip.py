"""Round trip of exports: GPX, GeoJSON, TUM, KITTI."""

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.outgoing import ExportDrawing, MissionExport
from webapp.missions.core.trajectory.records import join, make_poses
from webapp.missions.files.geojson_writer import format_mission_geojson
from webapp.missions.files.gpx_writer import format_mission_gpx
from webapp.missions.files.kml_writer import format_mission_kml
from webapp.missions.files.readers import geojson_reader, gpx, kml_reader, trajectory_text
from webapp.missions.files.track_chunks import Findings, RobotPiece, WorldPiece
from webapp.missions.files.trajectory_writer import format_kitti_zip, format_tum_zip


@pytest.mark.parametrize(
    ("write", "read"),
    [(format_mission_gpx, gpx.read), (format_mission_geojson, geojson_reader.read)],
)
def test_tracks_read_back(mission, write, read):
    pieces = list(read(io.BytesIO(b"".join(write(mission))), findings=Findings()))
    tracks = [piece for piece in pieces if isinstance(piece, WorldPiece)]
    assert [piece.source for piece in tracks] == ["gps", "odometry", "manual"]
    for track, found in zip(mission.tracks, tracks, strict=True):
        before = join(list(track.poses()))
        np.testing.assert_allclose(found.poses.latlon, before.latlon, atol=1e-9, rtol=0)
        np.testing.assert_allclose(found.poses.times_s, before.times_s, atol=1e-6, rtol=0)
        np.testing.assert_allclose(found.poses.heading_deg, before.heading_deg, atol=1e-3)
        np.testing.assert_allclose(found.poses.height_m, before.height_m, atol=1e-3)
        if write is format_mission_gpx:
            np.testing.assert_allclose(found.poses.covariance_m2, before.covariance_m2, rtol=1e-5)


@pytest.mark.parametrize(
    ("write", "read"),
    [(format_mission_kml, kml_reader.read), (format_mission_geojson, geojson_reader.read)],
)
def test_looks_of_tracks_read_back(poses, track, write, read):
    looks = [TrackLook("Team 2", "#d55e00", 6.0), TrackLook(), TrackLook(hidden=True)]
    tracks = [
        replace(track(poses(3), id=id, source="odometry"), look=look) for id, look in enumerate(looks, 1)
    ]
    findings = Findings()
    data = b"".join(write(MissionExport("way", tuple(tracks), (), list)))
    pieces = list(read(io.BytesIO(data), findings=findings))
    assert [piece.source for piece in pieces] == ["odometry"] * 3
    assert list(findings.looks.values()) == [looks[0], TrackLook(), TrackLook()]


def test_objects_of_our_geojson_keep_their_ids(mission):
    data = b"".join(format_mission_geojson(mission))
    pieces = list(geojson_reader.read(io.BytesIO(data), findings=Findings()))
    seen = [one for piece in pieces if not isinstance(piece, WorldPiece) for one in piece.sightings]
    for found, one in zip(mission.objects(), seen, strict=True):
        assert (one.latlon, one.height_m, one.confidence) == (found.latlon, found.height_m, found.confidence)
        assert (one.covariance_m2, one.size_m) == (found.covariance_m2, found.size_m)
        assert one.time_s == pytest.approx(found.last_time_s, abs=1e-6)
    assert (seen[0].object_id, seen[0].kind) == ("car-1", "car")


@pytest.mark.parametrize(
    ("write", "read"),
    [(format_mission_gpx, gpx.read), (format_mission_geojson, geojson_reader.read)],
)
def test_states_of_objects_read_back(mission, write, read):
    states = ("found", "confirmed", "cleared")
    objects = [replace(found, state=state) for found, state in zip(mission.objects(), states, strict=True)]
    data = b"".join(write(replace(mission, objects=lambda: iter(objects))))
    pieces = list(read(io.BytesIO(data), findings=Findings()))
    seen = [one for piece in pieces if not isinstance(piece, WorldPiece) for one in piece.sightings]
    assert tuple(one.state for one in seen) == states


def test_a_track_over_the_180th_meridian_reads_back(track):
    lon = np.array([179.9, 179.99, -179.98, -179.9])
    poses = make_poses(1.7e9 + np.arange(4.0), np.column_stack([np.full(4, 10.0), lon]))
    data = b"".join(format_mission_geojson(MissionExport("way", (track(poses),), (), list)))
    assert b"MultiLineString" in data
    (piece,) = geojson_reader.read(io.BytesIO(data), findings=Findings())
    np.testing.assert_allclose(piece.poses.latlon, poses.latlon, atol=1e-9)
    np.testing.assert_allclose(piece.poses.times_s, poses.times_s)


@pytest.mark.parametrize(("write", "layout"), [(format_tum_zip, "tum"), (format_kitti_zip, "kitti")])
def test_trajectories_read_back(mission, write, layout):
    archive = zipfile.ZipFile(io.BytesIO(b"".join(write(mission))))
    assert archive.namelist()[0] == f"1-gps.{layout}"
    first = join(list(mission.tracks[0].poses()))
    lat, lon = first.latlon[0].tolist()
    enu = LocalFrame(LatLon(lat, lon))
    whole = join(list(mission.tracks[1].poses()))
    name = next(name for name in archive.namelist() if name.startswith("2-odometry"))
    (piece,) = trajectory_text.read(io.BytesIO(archive.read(name)), layout, findings=Findings())
    assert isinstance(piece, RobotPiece)
    east_north = piece.poses.xyz_m[:, :2] if layout == "tum" else piece.poses.xyz_m[:, :2] @ [[0, 1], [-1, 0]]
    np.testing.assert_allclose(east_north, enu.enu_from_latlon(whole.latlon), atol=1e-3)
    turn = 90.0 if layout == "tum" else 0.0
    heading = (turn - np.degrees(piece.poses.yaw_rad)) % 360.0
    np.testing.assert_allclose(heading, whole.heading_deg, atol=1e-4)
    if layout == "tum":
        np.testing.assert_allclose(piece.poses.times_s, whole.times_s, atol=1e-6)
        (gps,) = trajectory_text.read(io.BytesIO(archive.read("1-gps.tum")), "tum", findings=Findings())
        assert np.isnan(gps.poses.yaw_rad).tolist() == np.isnan(first.heading_deg).tolist()


@pytest.mark.parametrize(
    ("write", "read"),
    [(format_mission_kml, kml_reader.read), (format_mission_geojson, geojson_reader.read)],
)
def test_drawings_read_back(mission, write, read):
    corners = tuple(LatLon(-16.8 + a, lon) for a, lon in ((0.0, 179.99), (0.0, -179.99), (0.01, -179.99)))
    about = {"note": "first\nthen <b>", "assigned": "Team & 2"}
    drawings = (
        ExportDrawing(1, "area", "Slope <1>", corners, 5.0, 8.5, 9.0, **about),
        ExportDrawing(2, "line", "Rope", corners[:2], 5.0),
        ExportDrawing(3, "marker", "Post", corners[:1], 5.0),
    )
    findings = Findings()
    pieces = list(read(io.BytesIO(b"".join(write(replace(mission, drawings=drawings)))), findings=findings))
    before = list(read(io.BytesIO(b"".join(write(mission))), findings=Findings()))
    assert len(pieces) == len(before)  # no drawing has become a track or an object
    area, line, marker = findings.drawn
    assert (area.name, area.assigned, area.radius_m, area.searched) == ("Slope <1>", "Team & 2", 8.5, True)
    assert [found.kind for found in findings.drawn] == ["area", "line", "marker"]
    for found, drawing in zip((area, line, marker), drawings, strict=True):
        np.testing.assert_allclose(found.points, drawing.points, atol=1e-9)


def test_drawings_of_files_are_checked():
    crossing = [[0, 0], [1e-3, 1e-3], [1e-3, 0], [0, 1e-3], [0, 0]]
    features = [
        {"geometry": {"type": "Polygon", "coordinates": [crossing]}, "properties": {"drawing": "area"}},
        {"geometry": {"type": "Point", "coordinates": [0, 0]}, "properties": {"drawing": "line"}},
        {"geometry": None, "properties": {"drawing": "marker"}},
        {
            "geometry": {"type": "Point", "coordinates": [1, 2]},
            "properties": {"drawing": "marker", "name": ["a"], "note": "\x00", "radius_m": "far"},
        },
    ]
    data = json.dumps(
        {"type": "FeatureCollection", "features": [{"type": "Feature"} | one for one in features]}
    )
    findings = Findings()
    assert list(geojson_reader.read(io.BytesIO(data.encode()), findings=findings)) == []
    (marker,) = findings.drawn
    assert (marker.points, marker.note) == (((2.0, 1.0),), "")
    assert [(one.reason, one.count) for one in findings.skipped()] == [("drawings with an invalid shape", 3)]
