"""GPX is read back as written."""

import gpxpy
import numpy as np
import pytest

from webapp.files.exchange.gpx import NAMESPACE
from webapp.missions.files.gpx_writer import format_mission_gpx

KEY = f"{{{NAMESPACE}}}"


@pytest.fixture
def read(mission):
    text = b"".join(format_mission_gpx(mission)).decode()
    gpx = gpxpy.parse(text)
    assert gpx.version == "1.1"
    return gpx


def joined(track, field):
    return np.concatenate([getattr(part, field) for part in track.poses()])


def test_every_pose_reads_back(mission, read):
    assert [track.source for track in read.tracks] == ["gps", "odometry", "manual"]
    for track, result in zip(mission.tracks, read.tracks, strict=True):
        assert len(result.segments) == 1
        points = result.segments[0].points
        assert len(points) == track.count
        at = [(point.latitude, point.longitude) for point in points]
        np.testing.assert_allclose(at, joined(track, "latlon"), atol=1e-9, rtol=0)
        times = [point.time.timestamp() for point in points]
        np.testing.assert_allclose(times, joined(track, "times_s"), atol=1e-6, rtol=0)
        heights = [np.nan if point.elevation is None else point.elevation for point in points]
        np.testing.assert_allclose(heights, joined(track, "height_m"), atol=1e-3)
        more = [{e.tag.removeprefix(KEY): e.text for e in point.extensions} for point in points]
        headings = [float(one.get("heading", "nan")) for one in more]
        np.testing.assert_allclose(headings, joined(track, "heading_deg"), atol=1e-3)
        result = [[float(v) for v in one.get("covariance", "nan nan nan").split()] for one in more]
        np.testing.assert_allclose(result, joined(track, "covariance_m2"), rtol=1e-5)


def test_objects_are_waypoints(mission, read):
    for found, point in zip(mission.objects(), read.waypoints, strict=True):
        assert (point.latitude, point.longitude, point.elevation) == (*found.latlon, found.height_m)
        assert point.type == found.kind.replace("\x07", "?")
        assert point.time.timestamp() == pytest.approx(found.last_time_s, abs=1e-6)
