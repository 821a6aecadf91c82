"""GeoJSON keeps to RFC 7946."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.missions.core.looks import TrackLook
from webapp.missions.core.trajectory.outgoing import ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.core.trajectory.symbols import kind_colour
from webapp.missions.files.geojson_writer import format_mission_geojson


def read(mission):
    return json.loads(b"".join(format_mission_geojson(mission)))


def test_tracks_are_lines_with_times(mission):
    content = read(mission)
    assert content["type"] == "FeatureCollection" and content["name"] == mission.name
    lines = content["features"][:3]
    assert [f["geometry"]["type"] for f in lines] == ["LineString", "LineString", "Point"]
    for track, feature in zip(mission.tracks[:2], lines, strict=False):
        latlon = np.concatenate([part.latlon for part in track.poses()])
        height = np.concatenate([part.height_m for part in track.poses()])
        positions = feature["geometry"]["coordinates"]
        np.testing.assert_allclose([p[:2] for p in positions], latlon[:, ::-1], atol=1e-9)
        assert [len(p) for p in positions] == [2 if np.isnan(h) else 3 for h in height]
        more = feature["properties"]["coordinateProperties"]
        assert len(more["times"]) == len(more["headings_deg"]) == len(positions)
        assert more["times"][0] == "2023-11-14T22:13:20.015625Z"


def test_colours_are_those_of_simplestyle(mission):
    first, *others = mission.tracks
    look = TrackLook("Team 2", "#12ab34", 6.5, hidden=True)
    styled, plain, *_ = read(replace(mission, tracks=(replace(first, look=look), *others)))["features"]
    names = ("name", "stroke", "stroke-width", "hidden")
    assert [styled["properties"][name] for name in names] == ["Team 2", "#12ab34", 6.5, True]
    assert [plain["properties"].get(name) for name in names[1:]] == ["#e69f00", 3.5, None]
    victim = read(mission)["features"][-1]["properties"]
    assert (victim["class"], victim["marker-color"]) == ("victim", kind_colour("victim"))


def test_objects_are_points(mission):
    points = read(mission)["features"][3:]
    for found, feature in zip(mission.objects(), points, strict=True):
        lon, lat, *height = feature["geometry"]["coordinates"]
        assert (lat, lon) == tuple(found.latlon)
        assert height == ([] if found.height_m is None else [found.height_m])
        assert (feature["id"], feature["properties"]["class"]) == (found.id, found.kind)


def test_a_mission_without_anything_is_a_collection_of_nothing():
    assert read(MissionExport("empty", (), (), list))["features"] == []


lons = st.lists(
    st.sampled_from([179.9, -179.9, 179.5, -179.5, 180.0, -180.0, 178.0]), min_size=2, max_size=12
)


@given(lons, st.integers(1, 5))
def test_a_track_over_the_180th_meridian_is_cut_there(lon, size):
    poses = make_poses(np.arange(len(lon)), np.column_stack([np.linspace(0, 1, len(lon)), lon]))
    parts = [poses.take(slice(first, first + size)) for first in range(0, len(lon), size)]
    track = ExportTrack(1, "gps", "", len(lon), 0.0, (0, min(lon), 1, max(lon)), lambda: parts)
    feature = read(MissionExport("m", (track,), (), list))["features"][0]
    over = max(lon) - min(lon) > 180
    assert feature["geometry"]["type"] == ("MultiLineString" if over else "LineString")
    lines = feature["geometry"]["coordinates"] if over else [feature["geometry"]["coordinates"]]
    times = feature["properties"]["coordinateProperties"]["times"]
    if over:
        assert [len(line) for line in lines] == [len(line) for line in times]
    for line in lines:
        assert len(line) >= 2
        assert np.abs(np.diff([p[0] for p in line])).max() <= 180
    for line, following in pairwise(lines):
        assert line[-1] == pytest.approx([-following[0][0], following[0][1]])
        assert abs(line[-1][0]) == 180
    inner = [p for n, line in enumerate(lines) for p in line[n > 0 : len(line) - (n < len(lines) - 1)]]
    assert [p[0] for p in inner] == lon
