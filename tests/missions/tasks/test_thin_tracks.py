"""Old tracks are thinned by rule: what is removed, what is kept, and a kill leaves each track complete."""

import os
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
from sqlalchemy import Engine, event, func, select

from webapp.app.registry import REGISTRY
from webapp.errors import Conflict
from webapp.jobs.worker import Worker
from webapp.missions.store import missions, query, reading, tracks
from webapp.missions.store.schema import Mission, MissionObject, ObjectSighting, Pose, Track
from webapp.missions.tasks import export, thin_tracks
from webapp.missions.tasks.thin_tracks import Rule
from webapp.missions.tasks.track_display import build_pieces
from webapp.progress import Progress
from webapp.settings import MissionSettings, Settings
from webapp.store.clock import now

METRE = Rule(1.0)
ENDS = Rule(None)


@contextmanager
def statements(library):
    """Collect each statement that is executed, with the number of its rows."""
    seen = []

    def executed(_connection, _cursor, statement, parameters, _context, many):
        seen.append((statement, len(parameters) if many else 1))

    event.listen(Engine, "before_cursor_execute", executed)
    yield seen
    event.remove(Engine, "before_cursor_execute", executed)


class Killed(BaseException):
    """Stands for a kill, which nothing may catch."""


@pytest.fixture
def old_mission(library, new_mission):
    """Make a mission that has not changed for 40 days and return its id."""

    def make(poses=5000, **fields):
        id = new_mission(poses)
        with library.database.write() as session:
            mission = session.get_one(Mission, id)
            for name, value in ({"changed_at": now() - timedelta(days=40)} | fields).items():
                setattr(mission, name, value)
        return id

    return make


def thinned(library, id, rule, *, writes=None, **more):
    write = writes or library.database.write
    return list(thin_tracks.thin_mission(library, id, rule=rule, write=write, progress=Progress(), **more))


def track_of(library, id):
    with library.database.read() as session:
        (track,) = tracks.list_tracks(session, id)
        return track, tracks.read(session, track)


def everything_else(library, id):
    """Return the facts of a mission apart from its poses."""
    with library.database.read() as session:
        (track,) = tracks.list_tracks(session, id)
        names = ("id", "source", "distance_m", "first_time_s", "last_time_s", "min_lat", "max_lon", "skipped")
        seen = [
            tuple(row.__dict__[column.name] for column in table.__table__.columns)
            for table in (MissionObject, ObjectSighting)
            for row in session.scalars(select(table).where(table.mission_id == id))
        ]
        return [getattr(track, name) for name in names], sorted(seen, key=repr)


def test_poses_go_and_nothing_else_changes(library, old_mission):
    id = old_mission()
    before, whole = track_of(library, id)
    known = everything_else(library, id)
    (result,) = thinned(library, id, METRE)
    track, left = track_of(library, id)
    assert everything_else(library, id) == known
    assert (result.before, result.after) == (before.poses, track.poses) == (5000, len(left))
    assert track.poses < 500
    assert (track.removed, track.thinned_m, track.thinned_poses) == (5000 - track.poses, 1.0, track.poses)
    places = np.searchsorted(whole.times_s, left.times_s)
    for name in ("times_s", "latlon", "height_m", "heading_deg", "covariance_m2", "travelled_m"):
        assert np.array_equal(getattr(left, name), getattr(whole, name)[places], equal_nan=True), name
    assert places[0] == 0 and places[-1] == 4999
    assert thinned(library, id, METRE) == [], "it is thinned already"


def farthest_m(whole, left):
    """Return the largest error of the motion, on a sphere."""
    lat, lon = (np.interp(whole.times_s, left.times_s, column) for column in left.latlon.T)
    north, east = (
        (lat - whole.latlon[:, 0]) * 111_300,
        (lon - whole.latlon[:, 1]) * 111_400 * np.cos(np.radians(50)),
    )
    return np.hypot(north, east).max()


def test_thinned_again_the_errors_add_up_to_what_is_allowed(library, old_mission):
    id = old_mission()
    _, whole = track_of(library, id)
    for to_m in (0.2, 0.5, 3.0):
        thinned(library, id, Rule(to_m))
        track, left = track_of(library, id)
        assert track.thinned_m == to_m
        assert farthest_m(whole, left) <= to_m
    assert thinned(library, id, Rule(2.0)) == [], "it is coarser already"


def test_poses_that_come_later_are_thinned_with_the_whole_tolerance(library, old_mission, some_poses):
    id = old_mission(3000)
    thinned(library, id, METRE)
    _, first = track_of(library, id)
    with library.database.write() as session:
        (track,) = tracks.list_tracks(session, id)
        later = some_poses(6000).take(slice(3000, None))
        tracks.append(session, track, later)
    thinned(library, id, METRE)
    track, left = track_of(library, id)
    assert np.array_equal(left.times_s[: len(first)], first.times_s)
    assert farthest_m(some_poses(6000), left) <= 1.0
    assert track.removed == 6000 - track.poses


def test_thinned_again_both_ends_of_a_gap_stay(library, old_mission, some_poses):
    id = old_mission(10)
    whole = some_poses(4000)
    line = replace(whole, latlon=whole.latlon[:1] + np.arange(4000)[:, None] * (0, 1e-6))
    line.times_s[2000:] += 60
    with library.database.write() as session:
        (track,) = tracks.list_tracks(session, id)
        tracks.clear(session, track)
        every_20_s = np.flatnonzero((np.arange(4000) % 40 == 0) | np.isin(np.arange(4000), (1999, 3999)))
        tracks.append(session, track, line.take(every_20_s))
        track.thinned_m, track.thinned_poses = 0.5, track.poses
    thinned(library, id, METRE)
    left = track_of(library, id)[1].times_s
    assert {line.times_s[1999], line.times_s[2000]} <= set(left.tolist())


def test_where_nothing_goes_no_pose_is_written(library, old_mission):
    id = old_mission(100)
    with library.database.write() as session, statements(library) as seen:
        (track,) = tracks.list_tracks(session, id)
        tracks.thin(session, track, tracks.read(session, track), thinned_m=1.0)
    assert [one for one in seen if one[0].startswith(("INSERT", "DELETE"))] == []
    track, left = track_of(library, id)
    assert (track.thinned_m, track.thinned_poses, len(left)) == (1.0, 100, 100)


@pytest.mark.usefixtures("sqlite_only")
def test_long_tracks_are_written_in_blocks(library, old_mission, monkeypatch):
    monkeypatch.setattr(tracks, "_BLOCK", 300)
    with statements(library) as seen:
        id = old_mission(1000)
    assert [count for text, count in seen if text.startswith("INSERT INTO pose")] == [300, 300, 300, 100]
    _, left = track_of(library, id)
    assert np.array_equal(left.travelled_m, np.arange(1000) / 4)


def rows_of_poses(library):
    with library.database.read() as session:
        return session.scalar(select(func.count()).select_from(Pose))


def test_rows_of_removed_poses_go_in_blocks_and_after_a_kill_they_hide_until_they_go(
    library, old_mission, monkeypatch, some_poses
):
    monkeypatch.setattr(tracks, "_BLOCK", 300)
    id = old_mission(1000)
    sizes = []

    @contextmanager
    def write():
        with library.database.write() as session:
            yield session
        sizes.append(rows_of_poses(library))
        if len(sizes) == 2:
            raise Killed

    with pytest.raises(Killed):
        thinned(library, id, ENDS, writes=write)
    assert sizes == [1000, 700]
    with library.database.read() as session:
        assert thin_tracks.due(session, ENDS) == [id]
        asked = query.parse_question(id, query.Question("poses", select="number"))
        assert list(query.answer(session, asked)) == [(0,), (1,)]
    with library.database.write() as session:
        (track,) = tracks.list_tracks(session, id)
        tracks.append(session, track, some_poses(1100).take(slice(1000, None)))
    track, left = track_of(library, id)
    assert (track.poses, len(left), left.times_s[-1]) == (102, 102, some_poses(1100).times_s[-1])
    thinned(library, id, ENDS)
    assert rows_of_poses(library) == 2
    with library.database.read() as session:
        assert thin_tracks.due(session, ENDS) == []


def test_pruned_both_ends_are_left(library, old_mission):
    id = old_mission()
    _, whole = track_of(library, id)
    known = everything_else(library, id)
    thinned(library, id, ENDS)
    track, left = track_of(library, id)
    assert left.times_s.tolist() == whole.times_s[[0, -1]].tolist()
    assert (track.removed, track.thinned_m) == (4998, None)
    assert everything_else(library, id) == known
    assert thinned(library, id, METRE) == []


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"keep": True}, "marked to be kept"),
        ({"binned_at": now()}, "in the bin"),
        ({"changed_at": now()}, "under way"),
    ],
)
def test_missions_that_are_kept_binned_or_under_way_stay(library, old_mission, fields, why):
    id = old_mission(100, **fields)
    with pytest.raises(Conflict, match=why):
        thinned(library, id, METRE)
    with library.database.read() as session:
        assert thin_tracks.due(session, METRE) == []


def test_a_rule_concerns_missions_of_an_age_that_it_has_not_thinned(library, old_mission):
    old, ended = old_mission(100), old_mission(100, changed_at=now(), ended_at=now())
    with library.database.read() as session:
        assert thin_tracks.due(session, Rule(1.0, timedelta(days=30))) == [old]
        assert thin_tracks.due(session, Rule(1.0, timedelta(days=50))) == []
        assert thin_tracks.due(session, METRE) == [old, ended]
    thinned(library, old, METRE)
    with library.database.read() as session:
        assert thin_tracks.due(session, METRE) == [ended]
        assert thin_tracks.due(session, Rule(2.0)) == [old, ended]
        assert session.get_one(Mission, old).changed_at < now() - timedelta(days=39), "its age counts on"


def test_a_dry_run_changes_nothing(library, old_mission):
    id = old_mission()
    (would,) = thinned(library, id, METRE, dry_run=True)
    assert track_of(library, id)[0].poses == 5000
    assert thinned(library, id, METRE) == [would]


def test_a_mission_that_changes_meanwhile_is_left_as_it_is(library, old_mission, monkeypatch):
    id = old_mission(100)
    left = thin_tracks._left

    def meanwhile(*given):
        with library.database.write() as session:
            missions.count_change(session.get_one(Mission, id))
        return left(*given)

    monkeypatch.setattr(thin_tracks, "_left", meanwhile)
    with pytest.raises(Conflict):
        thinned(library, id, METRE)
    assert track_of(library, id)[0].poses == 100


def test_pieces_for_display_are_those_of_the_poses_that_are_left(library, old_mission):
    id = old_mission(20_000)
    build_pieces(library, id, write=library.database.write, progress=Progress())
    thinned(library, id, Rule(0.01))
    track, left = track_of(library, id)
    with library.database.read() as session:
        assert all(
            piece.first_number + piece.count <= len(left)
            for piece in tracks.list_pieces(session, track, level=0)
        )


@pytest.mark.parametrize(("rule", "said"), [(METRE, b"1"), (ENDS, b"ends")])
def test_exports_say_that_a_track_was_thinned(library, old_mission, rule, said):
    id = old_mission()
    forms = ("gpx", "kml", "geojson", "csv", "tum.zip")
    plain = {form: b"".join(export.export_mission(library, id, form=form).pieces) for form in forms}
    thinned(library, id, rule)
    (track,) = reading.read(library.database, id).tracks
    for form in forms:
        written = b"".join(export.export_mission(library, id, form=form).pieces)
        assert len(written) < len(plain[form]) / 5
    assert "thinned" in track.remark if rule is METRE else "ends" in track.remark
    texts = {form: b"".join(export.export_mission(library, id, form=form).pieces) for form in forms}
    for form in ("gpx", "kml"):
        assert track.remark.encode() in texts[form]
        assert b"removed" not in plain[form]
    assert f'"removed_poses":{track.removed}'.encode() in texts["geojson"].replace(b" ", b"")
    first = texts["csv"].split(b"\r\n")[1]
    assert first.endswith(b",1" if rule is METRE else b",inf")


def test_the_worker_does_what_the_settings_ask_for(library, old_mission):
    old, kept = old_mission(1000), old_mission(1000, keep=True)

    def work(**given):
        settings = Settings(library=library.folder, missions=MissionSettings(**given))
        Worker(library, settings, registry=REGISTRY).run(once=True)
        return [track_of(library, id)[0].poses for id in (old, kept)]

    assert work() == [1000, 1000], "by default nothing is removed"
    assert work(thin_after_days=50) == [1000, 1000]
    left, whole = work(thin_after_days=30)
    assert (2 < left < 300, whole) == (True, 1000)
    assert work(prune_after_days=30, thin_after_days=10) == [2, 1000]


@pytest.mark.parametrize("after_commit", [False, True])
def test_killed_anywhere_each_track_is_whole_or_thinned(library, old_mission, after_commit):
    id = old_mission(1000)
    with library.database.write() as session:
        for source in ("odometry", "visual"):
            track = tracks.get_or_create(session, id, source=source)
            tracks.append(session, track, tracks.read(session, session.scalars(select(Track)).first()))
    expected = {track.source: track.after for track in thinned(library, id, METRE, dry_run=True)}
    kills = []

    @contextmanager
    def write():
        with library.database.write() as session:
            yield session
            if not after_commit and len(kills) < 2:
                raise Killed
        if after_commit:
            raise Killed

    for _ in range(10):
        try:
            thinned(library, id, METRE, writes=write)
            break
        except Killed:
            kills.append(True)
        with library.database.read() as session:
            found = {track.source: track.poses for track in tracks.list_tracks(session, id)}
        assert all(found[source] in (1000, expected[source]) for source in expected)
    assert len(kills) == (6 if after_commit else 2), "each track is replaced, then its rows are deleted"
    assert rows_of_poses(library) == sum(expected.values())
    with library.database.read() as session:
        assert {track.source: track.poses for track in tracks.list_tracks(session, id)} == expected


@pytest.mark.slow
def test_the_command_that_is_killed_goes_on(library, old_mission):
    ids = [old_mission(1000) for _ in range(3)]
    (would,) = thinned(library, ids[0], METRE, dry_run=True)
    command = [sys.executable, "-m", "webapp", "mission", "thin", "--older-than", "30", "--library"]
    for done in range(1, 3):
        environ = {**os.environ, "PYTHONUNBUFFERED": "1"}
        with subprocess.Popen([*command, str(library.folder)], stdout=subprocess.PIPE, env=environ) as run:
            assert run.stdout.readline()
            run.kill()
        after = [track_of(library, id)[0].poses for id in ids]
        assert sum(count == would.after for count in after) >= done
        assert set(after) <= {1000, would.after}
    subprocess.run([*command, str(library.folder)], check=True)
    assert [track_of(library, id)[0].poses for id in ids] == [would.after] * 3
