"""The fused track of a mission is written atomically."""

import json
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from filelock import FileLock, Timeout
from sqlalchemy import select
from sqlalchemy.orm import Session

from tests.missions.core.simulated import Drive
from tests.missions.core.test_fusion import BEGUN_S, FRAME, error_m, gps_of, odometry_of
from webapp.errors import Cancelled, Conflict, NotFound, UsageError
from webapp.missions.core.trajectory.fusion import Fusion
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, MissionPhoto, Pose, Track
from webapp.missions.tasks import fuse
from webapp.progress import Progress


@pytest.fixture
def driven(library, owner):
    """A mission with odometry and GPS, one fix of which is wrong: its id and the truth."""
    drive = Drive(3)
    drive.measured[20] += (0, 90)
    with library.database.write() as session:
        mission = missions.create(session, "Yard", account_id=owner)
        for source, poses in (("odometry", odometry_of(drive)), ("gps", gps_of(drive))):
            tracks.append(session, tracks.get_or_create(session, mission.id, source=source), poses)
    return mission.id, drive


def fused(library, mission_id):
    with library.database.read() as session:
        track = next(t for t in tracks.list_tracks(session, mission_id) if t.source == "fused")
        return track, tracks.read(session, track)


def run(library, mission_id, progress=None, odometry=None):
    return fuse.fuse_mission(
        library,
        mission_id,
        write=library.database.write,
        progress=progress or Progress(),
        odometry=odometry,
    )


def test_a_corrected_track_is_added_to_the_others(library, driven):
    mission_id, drive = driven
    report = run(library, mission_id)
    track, poses = fused(library, mission_id)
    assert track.poses == report["poses"] == drive.nodes
    assert error_m(Fusion(poses, {}, (), None), drive) < 1.5
    assert (poses.covariance_m2[:, :2] > 0).all()
    assert track.distance_m == pytest.approx(120, rel=0.1)
    with library.database.read() as session:
        assert [t.source for t in tracks.list_tracks(session, mission_id)] == ["odometry", "gps", "fused"]
        assert session.get_one(Mission, mission_id).revision == report["revision"] == 1


def test_removing_the_corrected_track_brings_the_recorded_ones_back(library, driven):
    mission_id, _ = driven
    run(library, mission_id)
    with FileLock(library.inner / fuse.LOCK), pytest.raises(Conflict, match="backup"):
        fuse.remove(library, mission_id, write=library.database.write)
    assert fused(library, mission_id)[0].poses
    fuse.remove(library, mission_id, write=library.database.write)
    with library.database.read() as session:
        assert [t.source for t in tracks.list_tracks(session, mission_id)] == ["odometry", "gps"]
        assert session.get_one(Mission, mission_id).revision == 2
    for remove_again in (fuse.read_report, lambda *a: fuse.remove(*a, write=library.database.write)):
        with pytest.raises(NotFound):
            remove_again(library, mission_id)


def test_a_removal_that_fails_keeps_track_and_report(library, driven):
    mission_id, _ = driven
    report = run(library, mission_id)

    @contextmanager
    def failing():
        with library.database.write() as session:
            yield session
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        fuse.remove(library, mission_id, write=failing)
    assert fuse.read_report(library, mission_id) == json.loads(json.dumps(report))
    assert fused(library, mission_id)[0].poses == report["poses"]


def test_a_report_left_behind_by_a_removal_that_was_killed_is_none(library, driven, monkeypatch):
    mission_id, _ = driven
    run(library, mission_id)
    path = missions.folder(library, mission_id) / fuse.REPORT
    kept = path.read_bytes()
    fuse.remove(library, mission_id, write=library.database.write)
    assert not path.exists()
    path.write_bytes(kept)
    with pytest.raises(NotFound, match="not been fused"):
        fuse.read_report(library, mission_id)


def test_a_plan_is_not_what_was_driven(library, driven):
    mission_id, drive = driven
    far = odometry_of(drive)
    far.latlon[:] += np.linspace(0, 1, len(far))[:, None]
    with library.database.write() as session:
        for name in ("bag /plan", "bag /goal_pose map"):
            plan = tracks.get_or_create(session, mission_id, source="odometry", name=name)
            tracks.append(session, plan, far)
        driven_id = next(t.id for t in tracks.list_tracks(session, mission_id) if t.source == "odometry")
    assert run(library, mission_id)["odometry"] == driven_id


NO_PLANS = (
    "bag /robot/goal_tracker/odom",
    "/plan_a/odom",
    "bag /goals/odometry_filtered map",
    "/plan_a/pose",
)


@pytest.mark.parametrize("name", NO_PLANS)
def test_odometry_in_a_space_named_like_a_plan_is_what_was_driven(library, driven, name):
    mission_id, _ = driven
    with library.database.write() as session:
        track = next(t for t in tracks.list_tracks(session, mission_id) if t.source == "odometry")
        track.name, id = name, track.id
    report = run(library, mission_id)
    assert (report["odometry"], report["planned"]) == (id, [])


@pytest.mark.parametrize("name", ["bag /plan", "bag /goal_pose map", "/plan_a/plan"])
def test_a_plan_alone_is_not_what_was_driven(library, driven, name):
    mission_id, _ = driven
    with library.database.write() as session:
        track = next(t for t in tracks.list_tracks(session, mission_id) if t.source == "odometry")
        track.name, id = name, track.id
    report = run(library, mission_id)
    assert (report["odometry"], report["planned"]) == (None, [id])


def test_what_was_left_out_is_reported_and_kept(library, driven):
    mission_id, drive = driven
    report = run(library, mission_id)
    (gated,) = report["gated"]
    assert (gated["source"], gated["number"]) == ("gps", 20)
    assert gated["off_m"] == pytest.approx(90, abs=8)
    assert gated["most_m"] < 20
    assert f"{gated['off_m']:.1f} m from where it was expected" in gated["reason"]
    expected = FRAME.enu_from_latlon([list(gated["expected"].values())])[0]
    assert np.hypot(*(expected - drive.truth[80])) < 10
    (statistics,) = report["fixes"]
    assert (statistics["used"], statistics["gated"]) == (59, 1)
    low, high = statistics["expected_between"]
    assert low < 2 < high
    assert fuse.read_report(library, mission_id) == json.loads(json.dumps(report))


@pytest.mark.slow
def test_of_two_receivers_the_one_that_was_too_sure_is_named_with_the_time(library, driven):
    mission_id, _ = driven
    drive = Drive(3, every=3)
    drive.measured += np.random.default_rng(3).normal(0, 9.0, drive.measured.shape)
    with library.database.write() as session:
        second = tracks.get_or_create(session, mission_id, source="gps", name="second")
        tracks.append(session, second, gps_of(drive))
        ids = [t.id for t in tracks.list_tracks(session, mission_id) if t.source == "gps"]
    report = run(library, mission_id)
    (too_sure,) = report["too_sure"]
    assert (too_sure["source"], too_sure["track"]) == ("gps", ids[1])
    assert too_sure["factor"] == pytest.approx(4.6, rel=0.35)
    assert too_sure["since_s"] == BEGUN_S
    assert [(one["source"], one["track"]) for one in report["fixes"]] == [("gps", id) for id in ids]
    assert [one["track"] for one in report["gated"] if one["number"] == 20] == [ids[0]]


def test_fixes_that_were_off_together_are_reported(library, driven):
    mission_id, _ = driven
    drive = Drive(3)
    drive.measured[30:36] += (40.0, 0.0)
    with library.database.write() as session:
        track = next(t for t in tracks.list_tracks(session, mission_id) if t.source == "gps")
        tracks.clear(session, track)
        tracks.append(session, track, gps_of(drive))
    (shifted,) = run(library, mission_id)["shifted"]
    assert (shifted["source"], shifted["fixes"]) == ("gps", 6)
    assert (shifted["from_s"], shifted["to_s"]) == (BEGUN_S + 60.0, BEGUN_S + 70.0)
    assert (shifted["east_m"], shifted["north_m"]) == pytest.approx((40.0, 0.0), abs=4.0)


def test_of_thinned_tracks_it_says_so_with_the_largest_error(library, driven):
    mission_id, _ = driven
    run(library, mission_id)
    assert (fused(library, mission_id)[0].removed, fused(library, mission_id)[0].thinned_m) == (0, None)
    with library.database.write() as session:
        for track, error_m in zip(tracks.list_tracks(session, mission_id), (0.5, 2.0), strict=False):
            track.removed, track.thinned_m, track.thinned_poses = 10, error_m, track.poses
    run(library, mission_id)
    track, _ = fused(library, mission_id)
    assert (track.removed, track.thinned_m, track.thinned_poses) == (20, 2.0, track.poses)


def test_done_again_it_is_the_same(library, driven):
    mission_id, _ = driven
    first, again = run(library, mission_id), run(library, mission_id)
    assert again == {**first, "revision": 2}
    assert fused(library, mission_id)[0].poses == first["poses"]


def test_stopped_it_leaves_the_former_track(library, driven):
    mission_id, _ = driven
    run(library, mission_id)
    before = fused(library, mission_id)[1]

    class Stop(Progress):
        def cancelled(self):
            return True

    with pytest.raises(Cancelled):
        run(library, mission_id, Stop())
    assert fused(library, mission_id)[1].latlon.tolist() == before.latlon.tolist()


def test_who_reads_meanwhile_sees_the_old_or_the_new(library, driven):
    mission_id, _ = driven
    count, seen = run(library, mission_id)["poses"], []
    worker = threading.Thread(target=run, args=(library, mission_id))
    worker.start()
    while worker.is_alive():
        seen.append(len(fused(library, mission_id)[1]))
    worker.join()
    assert set(seen) == {count}


def test_a_backup_waits_for_the_commit_and_the_report_only(library, driven, monkeypatch):
    mission_id, _ = driven
    held = {}

    def watched(module, name):
        original = getattr(module, name)

        def call(*args, **named):
            try:
                with FileLock(library.inner / fuse.LOCK, timeout=0):
                    held[name] = False
            except Timeout:
                held[name] = True
            return original(*args, **named)

        monkeypatch.setattr(module, name, call)

    watched(tracks, "append")
    watched(fuse, "_mark_photos")
    watched(Session, "commit")
    watched(fuse, "write_text")
    run(library, mission_id)
    assert held == {"append": False, "_mark_photos": False, "commit": True, "write_text": True}


def test_nobody_waits_for_a_fusion_that_waits_for_a_backup(library, driven, monkeypatch):
    mission_id, _ = driven
    rewritten = threading.Event()
    mark = fuse._mark_photos
    monkeypatch.setattr(fuse, "_mark_photos", lambda *args: (mark(*args), rewritten.set()))
    worker = threading.Thread(target=run, args=(library, mission_id))
    with FileLock(library.inner / fuse.LOCK):
        worker.start()
        assert rewritten.wait(10)
        with library.database.write() as session:
            session.get_one(Mission, mission_id).name = "Renamed"
            assert [t.source for t in tracks.list_tracks(session, mission_id)] == ["odometry", "gps"]
        with pytest.raises(NotFound):
            fuse.read_report(library, mission_id)
    worker.join(20)
    report = fuse.read_report(library, mission_id)
    assert fused(library, mission_id)[0].poses == report["poses"]
    with library.database.read() as session:
        assert session.get_one(Mission, mission_id).revision == report["revision"] == 1


def test_a_photo_whose_fix_was_left_out_says_so(library, driven):
    mission_id, drive = driven
    right, wrong = drive.truth[100], drive.truth[150] + (0, 200)
    with library.database.write() as session:
        for name, node, at in (("a", 100, right), ("b", 150, wrong)):
            lat, lon = FRAME.latlon_from_enu([at])[0].tolist()
            time_s = float(odometry_of(drive).times_s[node])
            session.add(
                MissionPhoto(
                    mission_id=mission_id, sha256=name * 64, name=name, path=name,
                    width=1, height=1, size_bytes=1, time_s=time_s,
                    fix={"lat": lat, "lon": lon, "time": time_s}, fix_state="done",
                )
            )  # fmt: skip
            poses = odometry_of(drive).take(slice(node, node + 1))
            poses.latlon[:] = lat, lon
            poses.covariance_m2[:] = 4.0, 4.0, 0.0
            tracks.append(
                session, tracks.get_or_create(session, mission_id, source="visual", name="photos"), poses
            )
    run(library, mission_id)
    with library.database.read() as session:
        photos = session.scalars(select(MissionPhoto).order_by(MissionPhoto.name)).all()
    assert [photo.fix["gated"] for photo in photos] == [False, True]
    assert "from where it was expected" in photos[1].fix["gated_why"]


def test_nothing_to_correct_by(library, owner):
    with library.database.write() as session:
        mission = missions.create(session, "Yard", account_id=owner)
        poses = odometry_of(Drive(0))
        tracks.append(session, tracks.get_or_create(session, mission.id, source="odometry"), poses)
    with pytest.raises(UsageError, match="no fix"):
        run(library, mission.id)
    with pytest.raises(NotFound, match="not been fused yet"):
        fuse.read_report(library, mission.id)


def test_a_mission_that_is_gone(library):
    with pytest.raises(NotFound):
        run(library, 77)


def test_of_a_long_track_some_poses_are_taken(library, driven, monkeypatch):
    mission_id, drive = driven
    monkeypatch.setattr(fuse, "MOST_POSES", 50)
    report = run(library, mission_id)
    assert report["poses"] <= 100
    assert error_m(Fusion(fused(library, mission_id)[1], {}, (), None), drive) < 2.0


@pytest.fixture
def twice(library, driven):
    """The mission with a second, longer odometry from the same time: its id, and those of both tracks."""
    mission_id, drive = driven
    longer = odometry_of(drive)
    longer.latlon[:] += np.linspace(0, 1e-3, len(longer))[:, None]
    with library.database.write() as session:
        track = tracks.get_or_create(session, mission_id, source="odometry", name="bag /wheel/odom")
        tracks.append(session, track, longer)
        first = next(t for t in tracks.list_tracks(session, mission_id) if t.source == "odometry")
        return mission_id, first.id, track.id


def test_of_several_odometries_from_the_same_time_one_has_to_be_chosen(library, twice):
    mission_id, first, second = twice
    with pytest.raises(UsageError, match="several tracks of odometry from the same time") as caught:
        run(library, mission_id)
    assert caught.value.where == "odometry"
    assert f"{first} (odometry, " in caught.value.hint and f"{second} (bag /wheel/odom, " in caught.value.hint
    for chosen, other in ((first, second), (second, first)):
        report = run(library, mission_id, odometry=chosen)
        assert (report["odometry"], report["others"]) == (chosen, [other])
    assert report["odometry_name"] == "bag /wheel/odom"


def test_only_odometry_of_the_mission_can_be_chosen(library, driven):
    mission_id, _ = driven
    with pytest.raises(UsageError, match="no odometry with the id 99") as caught:
        run(library, mission_id, odometry=99)
    assert "odometry, " in caught.value.hint


def test_of_several_odometries_one_after_the_other_the_longest_is_used(library, twice):
    mission_id, _, second = twice
    with library.database.write() as session:
        track = session.get_one(Track, second)
        for pose in session.scalars(select(Pose).where(Pose.track_id == second)):
            pose.time_s += 1e6
        track.first_time_s, track.last_time_s = track.first_time_s + 1e6, track.last_time_s + 1e6
    assert run(library, mission_id)["odometry"] == second
