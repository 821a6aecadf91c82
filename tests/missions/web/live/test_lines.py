"""Lines of tracks agree with the poses within the tolerance, in any view, prepared or not."""

import numpy as np
import pytest

from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.store import missions, tracks
from webapp.missions.tasks import track_display
from webapp.missions.tasks.track_display import LineView
from webapp.progress import Progress
from webapp.store.operate import jobs

COUNT = 5 * 4096 + 1000
DEGREE_M = 111_195.0


def wave(count):
    """Return poses of a path that swings 20 m to the sides, with 0.1 m steps."""
    n = np.arange(count)
    latlon = np.column_stack([n * 0.1, 20 * np.sin(n / 300)]) / DEGREE_M
    return make_poses(1e9 + n * 0.1, latlon, height_m=np.sin(n / 1000), heading_deg=n % 360)


@pytest.fixture
def track(library, mission):
    """A track with more poses than five pieces."""
    with library.database.write() as session:
        track = tracks.get_or_create(session, mission, source="gps")
        tracks.append(session, track, wave(COUNT))
    return track


@pytest.fixture
def build(library, mission):
    return lambda: track_display.build_pieces(
        library, mission, write=library.database.write, progress=Progress()
    )


@pytest.fixture
def line(library, mission, track):
    def read(**view):
        with library.database.read() as session:
            return track_display.track_line(
                session, tracks.find(session, mission, track.id), LineView(**view)
            )

    return read


def error_m(found, count=COUNT):
    """Return the error of a line, as a function of the northward distance."""
    metres = found.points[:, 2:4] * DEGREE_M
    n = np.arange(count)
    return np.abs(np.interp(n * 0.1, metres[:, 0], metres[:, 1]) - 20 * np.sin(n / 300)).max()


def test_a_job_is_queued_with_the_poses(library, mission, track):
    with library.database.read() as session:
        (job,) = jobs.list_jobs(session)
    assert (job.kind, job.arguments) == ("mission-pieces", {"mission": mission})


def test_all_whole_chunks_are_prepared_once(build, library, mission, track):
    assert build() == 5
    assert build() == 0
    with library.database.read() as session:
        assert tracks.find(session, mission, track.id).built_to == 5 * 4096


@pytest.mark.parametrize("tolerance", [0.5, 2.0, 3.0, 8.0])
def test_lines_are_as_fine_as_asked(build, line, tolerance):
    unbuilt = line(tolerance_m=tolerance)
    build()
    found = line(tolerance_m=tolerance)
    for one in (found, unbuilt) if unbuilt.complete else (found,):
        assert error_m(one) <= tolerance * 1.3  # measured east-west, not perpendicular to the line
        assert one.points[[0, -1], 0].tolist() == [0, COUNT - 1]
        assert np.all(np.diff(one.points[:, 0]) > 0)
    assert found.complete
    assert not len(found.gaps)
    assert len(found.points) < 1000


def test_points_are_poses(build, line):
    build()
    poses = wave(COUNT)
    points = line(tolerance_m=2.0).points
    numbers = points[:, 0].astype(int)
    assert np.array_equal(points[:, 1], poses.times_s[numbers])
    assert np.array_equal(points[:, 2:4], poses.latlon[numbers])
    assert np.array_equal(points[:, 4], poses.heading_deg[numbers])


def test_too_many_points_are_reported(build, line):
    build()
    found = line(tolerance_m=0.0)
    assert len(found.points) <= track_display.MOST
    assert not found.complete


def test_a_box_close_up_has_every_pose(build, line):
    build()
    box = (1000 / DEGREE_M, -1.0, 1010 / DEGREE_M, 1.0)
    found = line(box=box)
    assert (found.level, found.complete) == (-1, True)
    assert found.points[:, 0].tolist() == list(range(9_999, 10_102))  # one more on each side


def test_a_box_that_the_line_leaves_has_gaps(build, line):
    build()
    side = 15 / DEGREE_M
    found = line(tolerance_m=0.5, box=(0.0, side, 500 / DEGREE_M, 1.0))
    metres = found.points[:, 2:4] * DEGREE_M
    assert metres[:, 1].min() > 5
    steps = np.hypot(*np.diff(metres, axis=0).T)
    long = np.flatnonzero(steps > 60) + 1
    assert len(found.gaps) == 2
    assert set(long) <= set(found.gaps)


def test_a_box_outside_it_is_empty(build, line):
    build()
    assert not len(line(box=(-10.0, 3.0, 10.0, 4.0)).points)
    assert not len(line(box=(-10.0, 170.0, 10.0, -170.0)).points)
    assert len(line(tolerance_m=2.0, box=(-10.0, -1.0, 10.0, -1.5)).points)  # nearly outside the box


def test_since(build, line):
    build()
    for since in (COUNT - 10, 4096 * 5 - 1, 4096 * 4, 10_000):
        found = line(tolerance_m=0.5, since=since)
        assert found.points[0, 0] > since
        assert found.points[0, 0] < since + 400
        assert found.points[-1, 0] == COUNT - 1
    assert not len(line(since=COUNT - 1).points)


def test_more_poses_come_later(build, line, library, mission, track):
    build()
    with library.database.write() as session:
        found = tracks.find(session, mission, track.id)
        more = wave(COUNT + 20_000).take(slice(COUNT, None))
        tracks.append(session, found, more)
        missions.count_change(session.get_one(missions.Mission, mission))
    assert build() == 5  # the previous tail becomes part of the first of these
    assert error_m(line(tolerance_m=2.0), COUNT + 20_000) <= 2.6


def test_a_long_track_that_is_not_prepared(line, library, mission, track):
    with library.database.write() as session:
        found = tracks.find(session, mission, track.id)
        tracks.append(session, found, wave(COUNT + 20_000).take(slice(COUNT, None)))
    found = line(tolerance_m=2.0)
    assert not found.complete
    assert error_m(found, COUNT + 20_000) < 4


def test_over_the_api(client, mission, track, build):
    build()
    base = f"/api/v1/missions/{mission}/tracks/{track.id}"
    result = client.get(f"{base}/line?tolerance_m=2").json
    assert result["complete"]
    assert result["points"][0] == [0, 1e9, 0.0, 0.0, 0.0]
    profile = client.get(f"{base}/profile?points=50").json
    assert len(profile["time_s"]) == len(profile["height_m"]) <= 50
    assert profile["travelled_m"][-1] == pytest.approx(
        client.get(f"/api/v1/missions/{mission}").json["tracks"][0]["distance_m"]
    )
    assert client.get(f"{base}/line?south=1").json["error"]["where"] == "south"
    assert client.get(f"{base}9/line").status_code == 404


def test_the_profile_of_a_long_track_is_read_from_what_was_prepared(client, mission, track, library, build):
    with library.database.write() as session:
        tracks.append(
            session, tracks.find(session, mission, track.id), wave(COUNT + 30_000).take(slice(COUNT, None))
        )
    address = f"/api/v1/missions/{mission}/tracks/{track.id}/profile"
    before = client.get(address).json
    build()
    after = client.get(address).json
    for result in (before, after):
        assert max(result["height_m"]) == pytest.approx(1, abs=1e-3)
        assert result["time_s"][-1] == pytest.approx(1e9 + (COUNT + 30_000 - 1) * 0.1)


def test_a_track_that_is_cleared(build, line, library, mission, track):
    build()
    with library.database.write() as session:
        found = tracks.find(session, mission, track.id)
        tracks.clear(session, found)
        tracks.append(session, found, wave(10))
    assert len(line().points) == 10
    assert build() == 0
