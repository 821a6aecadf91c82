"""Time stamps of messages in bags that are odd."""

import numpy as np
import pytest

from webapp.missions.files.readers import rosbag
from webapp.missions.files.readers.bag_limits import BACK, BAD_STAMP, NO_STAMP
from webapp.missions.files.track_chunks import Findings

START = 1_777_629_600.0
DAY = 86_400.0


@pytest.fixture
def read(ros, tmp_path):
    """Write a bag with odometry and fixes of these stamps, one a second; return its pieces and findings."""

    def write(stamps, *, recorded=START, ros1=False):
        m = ros(ros1)
        messages = []
        for n, stamp in enumerate(stamps):
            messages.append(("/odom", recorded + n, m.odometry(stamp, m.pose(float(n)))))
            messages.append(("/fix", recorded + n, m.fix(stamp, 50.0 + n * 1e-5, 14.0)))
        path = m.bag(tmp_path / ("a.bag" if ros1 else "a"), messages)
        findings = Findings()
        pieces = list(rosbag.read(path, suffix=".bag" if ros1 else ".db3", findings=findings))
        return [piece.poses.times_s.tolist() for piece in pieces], findings

    return write


WILD = [(int(START + n) * 10**9) % 2**31 for n in range(20)]
"""Nanoseconds in the field of seconds, cut off to its 31 bits."""

ODD = {
    "none": ([0.0] * 20, NO_STAMP, ""),
    "since a start": ([5.0 + n for n in range(20)], BAD_STAMP, ", 1970-01-01"),
    "future": ([START + 3000 * DAY + n for n in range(20)], BAD_STAMP, ", 2034-07-18"),
    "nanoseconds as seconds": (WILD, BAD_STAMP, ""),
    "milliseconds as seconds": ([(START + n) * 1000 % 2**31 for n in range(20)], BAD_STAMP, ""),
}


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.parametrize("ros1", [True, False])
def test_stamps_that_cannot_be_right_are_replaced_by_the_time_of_the_recording(read, kind, ros1):
    stamps, reason, day = ODD[kind]
    tracks, findings = read(stamps, ros1=ros1)
    assert tracks == [[START + n for n in range(20)]] * 2
    doubts = {one.reason: one for one in findings.doubts()}
    assert doubts[reason].count == 40
    assert doubts[reason].where.startswith("/odom")
    assert doubts[reason].where.endswith(day)


def test_single_stamps_are_replaced(read):
    stamps = [START + n for n in range(20)]
    stamps[7], stamps[9] = 0.0, 12.0
    tracks, findings = read(stamps)
    assert tracks == [[START + n for n in range(20)]] * 2
    assert {one.reason: one.count for one in findings.doubts()} == {NO_STAMP: 2, BAD_STAMP: 2}


def test_stamps_that_jump_back_are_counted(read):
    stamps = [START + n - (600.0 if n >= 15 else 0.0) for n in range(30)]
    (odometry, fixes), findings = read(stamps)
    assert odometry == fixes == stamps
    assert {one.reason: one.count for one in findings.doubts()} == {BACK: 2}


@pytest.mark.parametrize(
    ("shift", "said"),
    [(-40 * DAY, "40 days before"), (-5.0 * 3600, "5.0 hours before"), (7200.0, "2.0 hours after")],
)
def test_stamps_long_before_the_recording_count_and_are_said(read, shift, said):
    stamps = [START + shift + n for n in range(20)]
    tracks, findings = read(stamps)
    assert tracks == [stamps] * 2
    assert f"the time stamps of /odom are {said} the recording: the stamps count" in findings.notes
    assert not findings.doubts()


@pytest.mark.parametrize("recorded", [0.0, 1000.0])
def test_a_recorder_without_a_clock_does_not_spoil_the_stamps(read, recorded):
    stamps = [START + n for n in range(20)]
    tracks, findings = read(stamps, recorded=recorded)
    assert np.array_equal(tracks, [stamps] * 2)
    assert any("after the recording" in note for note in findings.notes)


def test_ordinary_stamps_are_not_mentioned(read):
    _, findings = read([START + n - 0.05 for n in range(20)])
    assert not findings.notes
    assert not findings.doubts()


@pytest.mark.parametrize("odd", [0, 1, 3])
def test_an_odd_stamp_of_a_slow_topic_does_not_discard_the_others(ros, tmp_path, odd):
    """The topic has 3 messages among the first 500 of the bag, and many later."""
    m = ros(False)
    slow = [START + 60.0 * n - (90.0 if n == odd else 0.0) for n in range(20)]
    messages = [
        ("/odom", START + 0.25 * n, m.odometry(START + 0.25 * n, m.pose(float(n)))) for n in range(2400)
    ]
    messages += [("/fix", START + 60.0 * n, m.fix(stamp, 50.0, 14.0)) for n, stamp in enumerate(slow)]
    messages.sort(key=lambda one: one[1])
    findings = Findings()
    pieces = list(rosbag.read(m.bag(tmp_path / "a", messages), suffix=".db3", findings=findings))
    (fixes,) = [piece for piece in pieces if piece.track == "/fix"]
    assert fixes.poses.times_s.tolist() == slow
    assert BAD_STAMP not in {one.reason for one in findings.doubts()}


def test_an_odd_stamp_of_a_topic_with_few_messages_is_kept(read):
    stamps = [START + n - (90.0 if n == 1 else 0.0) for n in range(4)]
    (odometry, fixes), _ = read(stamps)
    assert odometry == fixes == stamps


def test_a_path_whose_stamps_cannot_be_right_grows_with_the_recording(ros, tmp_path):
    m = ros(False)
    poses = [m.stamped(5.0 + n, m.pose(float(n))) for n in range(6)]
    messages = [("/path", START + n, m.path(poses[: n + 1])) for n in range(6)]
    findings = Findings()
    (piece,) = rosbag.read(m.bag(tmp_path / "a", messages), suffix=".db3", findings=findings)
    assert piece.poses.times_s.tolist() == [START + n for n in range(6)]
    assert piece.poses.xyz_m[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert {one.reason: one.count for one in findings.doubts()} == {BAD_STAMP: 6}


def test_a_growing_path_does_not_jump_back(ros, tmp_path):
    m = ros(False)
    poses = [m.stamped(START + 30.0 * n, m.pose(float(n))) for n in range(10)]
    messages = [("/path", START + 30.0 * n, m.path(poses[: n + 1])) for n in range(10)]
    findings = Findings()
    (piece,) = rosbag.read(m.bag(tmp_path / "a", messages), suffix=".db3", findings=findings)
    assert piece.poses.times_s.tolist() == [START + 30.0 * n for n in range(10)]
    assert not findings.doubts()


def test_poses_that_a_path_repeats_without_stamps_are_counted_once(ros, tmp_path):
    m = ros(False)
    poses = [m.stamped(0.0, m.pose(float(n))) for n in range(6)]
    messages = [("/path", START + n, m.path(poses[: n + 1])) for n in range(6)]
    findings = Findings()
    (piece,) = rosbag.read(m.bag(tmp_path / "a", messages), suffix=".db3", findings=findings)
    assert piece.poses.times_s.tolist() == [START + n for n in range(6)]
    assert {one.reason: one.count for one in findings.doubts()} == {NO_STAMP: 6}


def test_objects_have_the_time_of_the_recording_too(ros, tmp_path):
    m = ros(False)
    messages = [("/odom", START, m.odometry(START, m.pose(0.0)))]
    messages += [
        ("/seen", START + n, m.detections(7.0, [("a", "car", 1.0, m.pose(1.0))], "base_link")) for n in (1, 2)
    ]
    pieces = list(rosbag.read(m.bag(tmp_path / "a", messages), suffix=".db3", findings=Findings()))
    assert [one.time_s for piece in pieces[1:] for one in piece.sightings] == [START + 1, START + 2]
