"""The contents of a file are reported before anything is stored."""

import numpy as np
import pytest

from webapp.core.geo.types import LatLon
from webapp.errors import TrackError
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.tasks.inspect_file import NEEDS_START, as_json, inspect_file
from webapp.missions.tasks.place_track import (
    BACKWARDS,
    NULL_ISLAND,
    TOO_EARLY,
    TOO_LATE,
    ReadOptions,
)

NOW = 1.7e9


def written(folder, text, name="log.csv"):
    path = folder / name
    path.write_text(text)
    return path


def test_each_source_with_times_and_extent(tmp_path):
    rows = "".join(f"{NOW - 1000 + i},{50 + i * 1e-5:.5f},{14 - i * 1e-5:.5f},{i}\n" for i in range(2000))
    path = written(tmp_path, "time,lat,lon,heading\n" + rows)
    report = inspect_file(path, now_s=NOW)
    (source,) = report.sources
    assert (source.poses, source.frame, source.headings, source.heights) == (2000, "earth", 2000, 0)
    assert (source.first_time_s, source.last_time_s) == (NOW - 1000, NOW + 999)
    assert source.extent == {"south": 50.0, "west": 13.98001, "north": 50.01999, "east": 14.0}
    assert source.distance_m == pytest.approx(1999 * 1.3226, rel=1e-3)
    assert 400 <= len(source.line) <= 801
    assert source.line[0] == (50.0, 14.0)
    assert source.line[-1] == (50.01999, 13.98001)
    assert not (report.doubts or report.skipped or report.problem)
    assert report.table.columns == {"time": 0, "lat": 1, "lon": 2, "heading": 3}
    assert as_json(report)["sources"][0]["first_time"] == "2023-11-14T21:56:40.000000Z"


def test_what_can_hardly_be_true_is_said(tmp_path):
    path = written(tmp_path, "time,lat,lon\n-1e8,50,14\n4e9,50,14\n1e9,50,14\n1e9,0,0\n")
    reasons = {one.reason: (one.count, one.where) for one in inspect_file(path, now_s=NOW).doubts}
    assert reasons == {
        TOO_EARLY: (1, "line 1, 1966-10-31"),
        TOO_LATE: (1, "line 1, 2096-10-02"),
        BACKWARDS: (1, "line 1"),
        NULL_ISLAND: (1, "line 1"),
    }


def test_a_robots_frame_is_measured_without_a_start(tmp_path):
    turned = f"0 0 {np.sin(np.pi / 4)} {np.cos(np.pi / 4)}"
    path = written(tmp_path, f"1e9 5 5 1 {turned}\n1.1e9 5 8 2 {turned}\n", "way.tum")
    report = inspect_file(path, now_s=NOW)
    (source,) = report.sources
    assert (source.frame, source.source) == ("robot", "odometry")
    assert source.extent == {"x": 0.0, "y": 3.0, "z": 1.0}
    assert source.distance_m == pytest.approx(3.0)
    assert np.allclose(source.line, [[0.0, 0.0], [3.0, 0.0]]), "forward of the first pose"
    assert NEEDS_START in report.notes
    started = inspect_file(path, options=ReadOptions(start=Start(LatLon(50.0, 14.0), 0.0)), now_s=NOW)
    assert started.sources == report.sources


def test_tracks_in_one_frame_keep_their_distance(tmp_path):
    rows = "1e9,5,5,0,a\n1.1e9,6,5,0,a\n1e9,5,9,0,b\n1.1e9,7,9,0,b\n"
    report = inspect_file(written(tmp_path, "time,x,y,yaw,track\n" + rows), now_s=NOW)
    assert [source.line for source in report.sources] == [[(0.0, 0.0), (1.0, 0.0)], [(0.0, 4.0), (2.0, 4.0)]]
    assert report.options == ("columns", "axes")


def test_a_table_whose_columns_are_unknown_shows_its_head(tmp_path):
    report = inspect_file(written(tmp_path, "a;b\n1;2\n3;4\n"))
    assert "no columns of positions" in report.problem
    assert (report.table.header, report.table.rows) == (("a", "b"), (("1", "2"), ("3", "4")))
    assert inspect_file(written(tmp_path, "a;b\n1;2\n"), options=ReadOptions(columns="lat=a, lon=b")).sources


def test_a_file_with_nothing_to_import_has_a_problem(tmp_path):
    report = inspect_file(written(tmp_path, "<kml/>"))
    assert report.problem == "nothing in it can be used: it has no track and no object"
    with pytest.raises(TrackError, match="neither GPX, TCX nor KML"):
        inspect_file(written(tmp_path, "<svg/>"))
