"""Bags of ROS 1 and ROS 2: all formats, and damaged ones."""

import math
import random
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from webapp.errors import TrackError
from webapp.missions.files.readers import bag_frames, rosbag
from webapp.missions.files.readers.bag_frames import FrameTree, slerp
from webapp.missions.files.track_chunks import Findings, RobotObjects, RobotPiece, WorldPiece

KINDS = pytest.mark.parametrize(
    ("ros1", "mcap", "suffix"), [(True, False, ".bag"), (False, False, ".db3"), (False, True, ".mcap")]
)


def read(path: Path, suffix: str, wanted: tuple[str, ...] = ()) -> tuple[list[object], Findings]:
    findings = Findings()
    return list(rosbag.read(path, suffix=suffix, wanted=wanted, findings=findings)), findings


@KINDS
def test_every_kind_of_bag_gives_its_poses_and_objects(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    path = m.bag(
        tmp_path / f"one{suffix if ros1 else ''}",
        [
            ("/fix", 100.0, m.fix(99.5, 50.0, 14.0, variance=2.0)),
            ("/odom", 100.1, m.odometry(100.05, m.pose(1.0, 2.0, 3.0, yaw=0.5), variance=0.25)),
            ("/pose", 100.2, m.pose(5.0)),
            ("/stamped", 100.3, m.stamped(100.25, m.pose(6.0), "map")),
            ("/fix", 100.4, m.fix(100.5, 50.1, 14.1, status=-1)),
            (
                "/seen",
                100.5,
                m.detections(
                    100.45, [("a1", "car", 0.75, m.pose(3.0, 1.0)), ("", "x", 1.0, m.pose(1))], "base_link"
                ),
            ),
            (
                "/marks",
                100.6,
                m.markers(100.55, [("barrel", 7, 0, m.pose(2.0)), ("barrel", 8, 2, m.pose(2.0))], "odom"),
            ),
            ("/odom", 100.7, m.odometry(0.0, m.pose(math.nan))),
        ],
        mcap=mcap,
    )
    pieces, findings = read(path, suffix)
    fix, odometry, pose, stamped, seen, marks = pieces
    assert isinstance(fix, WorldPiece)
    assert fix.poses.latlon.tolist() == [[50.0, 14.0]]
    assert fix.poses.times_s.tolist() == [99.5], "the time of the header, not of the recording"
    assert fix.poses.covariance_m2.tolist() == [[2.0, 4.0, 0.0]]
    assert isinstance(odometry, RobotPiece)
    assert (odometry.track, odometry.frame, odometry.body) == ("/odom", "odom", "base_link")
    assert odometry.poses.xyz_m.tolist() == [[1.0, 2.0, 3.0]]
    assert odometry.poses.yaw_rad[0] == pytest.approx(0.5)
    assert odometry.poses.covariance_m2.tolist() == [[0.25, 0.25, 0.0]]
    assert pose.poses.times_s[0] == pytest.approx(100.2), (
        "a pose without a header has the time of the recording"
    )
    assert (stamped.frame, stamped.poses.xyz_m[0, 0]) == ("map", 6.0)
    assert isinstance(seen, RobotObjects)
    assert seen.frame == "base_link"
    car, anonymous = seen.sightings
    assert (anonymous.object_id, anonymous.kind, anonymous.size_m) == (None, "x", (1.0, 1.0, 1.0))
    assert (car.object_id, car.kind, car.confidence, car.xyz_m) == ("a1", "car", 0.75, (3.0, 1.0, 0.0))
    (barrel,) = marks.sightings
    assert (barrel.object_id, barrel.kind) == ("barrel/7", "barrel")
    result = {one.reason: (one.count, one.where) for one in findings.skipped()}
    assert result == {
        "fixes marked invalid by the receiver": (1, "/fix"),
        "poses with a time or a position that is not a number": (1, "/odom"),
    }


@KINDS
def test_a_bag_is_read_whatever_it_is_called(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    path = m.bag(
        tmp_path / f"one{suffix if ros1 else ''}", [("/fix", 1.0, m.fix(1.0, 50.0, 14.0))], mcap=mcap
    )
    other = path.rename(tmp_path / "upload.part")
    pieces, _ = read(other, suffix)
    assert len(pieces) == 1
    assert [topic.readable for topic in rosbag.topics(other, suffix=suffix)] == [True]


def test_the_folder_of_a_ros2_bag_is_read(ros, tmp_path) -> None:
    m = ros(False)
    m.bag(tmp_path / "folder", [("/fix", 1.0, m.fix(1.0, 50.0, 14.0))])
    pieces, _ = read(tmp_path / "folder", "")
    assert pieces[0].poses.latlon.tolist() == [[50.0, 14.0]]


@pytest.mark.parametrize("stamped", [True, False])
def test_a_growing_path_is_one_track(ros, tmp_path, stamped) -> None:
    m = ros(True)
    poses = [m.stamped(10.0 + i if stamped else 0.0, m.pose(float(i))) for i in range(5)]
    path = m.bag(tmp_path / "p.bag", [("/path", 20.0 + n, m.path(poses[:n])) for n in (2, 3, 3, 5)])
    pieces, _ = read(path, ".bag")
    assert [x for piece in pieces for x in piece.poses.xyz_m[:, 0].tolist()] == [0.0, 1.0, 2.0, 3.0, 4.0]
    times = [t for piece in pieces for t in piece.poses.times_s.tolist()]
    assert times == pytest.approx([10, 11, 12, 13, 14] if stamped else [22, 22, 23, 25, 25])


def test_topics_are_chosen_and_the_others_counted(ros, tmp_path) -> None:
    m = ros(True)
    path = m.bag(
        tmp_path / "t.bag",
        [
            ("/a", 1.0, m.pose(1.0)),
            ("/b", 2.0, m.pose(2.0)),
            ("/b", 3.0, m.pose(3.0)),
            ("/c", 3.0, m.header(1.0)),
        ],
    )
    pieces, findings = read(path, ".bag", ("/a",))
    assert [piece.track for piece in pieces] == ["/a"]
    assert {one.where: one.count for one in findings.skipped()} == {"/b": 2, "/c": 1}
    with pytest.raises(TrackError, match="no topic '/x'"):
        read(path, ".bag", ("/x",))
    with pytest.raises(TrackError, match="no known poses"):
        read(path, ".bag", ("/c",))
    listed = {
        topic.name: (topic.type, topic.messages, topic.readable)
        for topic in rosbag.topics(path, suffix=".bag")
    }
    assert listed["/b"] == ("geometry_msgs/msg/Pose", 2, True)
    assert listed["/c"] == ("std_msgs/msg/Header", 1, False)


def test_a_bag_without_poses_is_reported(ros, tmp_path) -> None:
    m = ros(True)
    with pytest.raises(TrackError, match="no topic with poses"):
        read(m.bag(tmp_path / "n.bag", [("/c", 3.0, m.header(1.0))]), ".bag")


@KINDS
def test_damaged_bags_are_refused_or_read_never_worse(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    messages = [("/odom", float(i), m.odometry(float(i), m.pose(float(i)))) for i in range(1, 20)]
    path = m.bag(tmp_path / f"d{suffix if ros1 else ''}", messages, mcap=mcap)
    good = path.read_bytes()
    rng = random.Random(7)
    bad = [good[: len(good) // 2], good[:20]]
    for _ in range(60):
        spoilt = bytearray(good)
        for _ in range(5):
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
        bad.append(bytes(spoilt))
    refused = 0
    for data in bad:
        path.write_bytes(data)
        try:
            read(path, suffix)
        except TrackError:
            refused += 1
    assert refused >= 2


@KINDS
def test_transforms_to_the_robot_are_a_track_where_nothing_else_says_it_or_if_asked(
    ros, tmp_path, ros1, mcap, suffix
) -> None:
    m = ros(ros1)
    moves = [
        (99.5, "odom", "base_link", m.pose(1.0, 2.0, yaw=0.5)),
        (99.5, "base_link", "wheel", m.pose(9.0)),
    ]
    messages = [
        ("/tf", 100.0, m.transforms(moves)),
        ("/tf", 100.1, m.transforms([(99.6, "robot/odom", "robot/base_footprint", m.pose(3.0))])),
        ("/tf", 100.2, m.transforms([(99.7, "map", "odom", m.pose(4.0))])),
    ]
    path = m.bag(tmp_path / f"one{suffix if ros1 else ''}", messages, mcap=mcap)
    first, second = read(path, suffix)[0]
    assert (first.track, first.source) == ("/tf odom base_link", "odometry")
    assert (first.frame, first.body) == ("odom", "base_link")
    assert first.poses.times_s.tolist() == [99.5] and first.poses.xyz_m.tolist() == [[1.0, 2.0, 0.0]]
    assert first.poses.yaw_rad[0] == pytest.approx(0.5)
    assert second.track == "/tf robot/odom robot/base_footprint"
    assert (second.frame, second.body) == ("robot/odom", "robot/base_footprint")
    both = [*messages, ("/odom", 100.3, m.odometry(99.5, m.pose(1.0)))]
    path = m.bag(tmp_path / f"two{suffix if ros1 else ''}", both, mcap=mcap)
    pieces, findings = read(path, suffix)
    assert [piece.track for piece in pieces] == ["/odom"]
    assert [(s.where, s.count) for s in findings.skipped()] == [("/tf", 3)]
    assert len(read(path, suffix, ("/tf",))[0]) == 2


@KINDS
def test_each_of_several_robots_is_a_track(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    messages = [
        (
            "/tf",
            100.0 + n,
            m.transforms([(100.0 + n, f"r{k}/odom", f"r{k}/base_link", m.pose(n + 100.0 * k))]),
        )
        for n in range(10)
        for k in (1, 2)
    ]
    pieces, findings = read(m.bag(tmp_path / f"r{suffix if ros1 else ''}", messages, mcap=mcap), suffix)
    assert [piece.track for piece in pieces] == [f"/tf r{k}/odom r{k}/base_link" for k in (1, 2)]
    assert [piece.poses.xyz_m[:, 0].tolist() for piece in pieces] == [
        [float(n + 100 * k) for n in range(10)] for k in (1, 2)
    ]
    assert findings.notes == ["/tf has poses in several frames: each is a track of its own"]
    only = [(topic, at, message) for n, (topic, at, message) in enumerate(messages) if n % 2]
    pieces, _ = read(m.bag(tmp_path / f"o{suffix if ros1 else ''}", only, mcap=mcap), suffix)
    assert [piece.track for piece in pieces] == ["/tf"]


def test_frames_of_a_topic_of_poses_are_tracks_too(ros, tmp_path) -> None:
    m = ros(True)
    messages = [
        ("/pose", 1.0 + n, m.stamped(1.0 + n, m.pose(float(n)), ("map", "/odom")[n % 2])) for n in range(6)
    ]
    pieces, _ = read(m.bag(tmp_path / "f.bag", messages), ".bag")
    assert [(piece.track, len(piece.poses)) for piece in pieces] == [("/pose", 3), ("/pose odom", 3)]


@KINDS
def test_objects_get_from_any_frame_to_one_with_poses(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    quarter = np.pi / 2
    seen = [("a", "car", 1.0, m.pose(2.0, 0.0, 0.5))]
    messages = [
        ("/seen", 99.0, m.detections(99.0, seen, "camera")),
        ("/odom", 100.0, m.odometry(100.0, m.pose(1.0))),
        ("/tf", 100.1, m.transforms([(100.1, "base_link", "mast", m.pose(0.0, 0.0, 1.0))])),
        ("/seen", 100.2, m.detections(100.2, seen, "/camera")),
        ("/tf", 100.3, m.transforms([(100.3, "base_link", "mast", m.pose(0.0, 0.0, 1.0, yaw=quarter))])),
        ("/seen", 100.4, m.detections(100.4, seen, "camera")),
        ("/marks", 100.5, m.markers(100.5, [("door", 1, 0, m.pose(7.0))], "unknown")),
        ("/marks", 100.6, m.markers(100.6, [("door", 2, 0, m.pose(7.0))], "circle")),
        ("/tf_static", 101.0, m.transforms([
            (0.0, "mast", "camera", m.pose(0.1, 0.0, 0.2)),
            (0.0, "other", "circle", m.pose(1.0)),
            (0.0, "circle", "other", m.pose(1.0)),
        ])),
    ]  # fmt: skip
    path = m.bag(tmp_path / f"tree{suffix if ros1 else ''}", messages, mcap=mcap)
    early, _, first, turned, unknown, circle = read(path, suffix)[0]
    assert (early.frame, early.sightings[0].xyz_m) == ("camera", (2.0, 0.0, 0.5)), "no pose was known"
    assert (first.frame, turned.frame) == ("base_link", "base_link")
    between = 2.1 * math.sqrt(0.5)  # in the middle between 0 and 90 degrees
    assert first.sightings[0].xyz_m == pytest.approx((between, between, 1.7))
    assert turned.sightings[0].xyz_m == pytest.approx((0.0, 2.1, 1.7))
    assert first.sightings[0].size_m == (1.0, 1.0, 1.0)
    assert (unknown.frame, circle.frame) == ("unknown", "circle")


def test_objects_on_the_map_get_into_the_frame_of_odometry(ros, tmp_path) -> None:
    m = ros(False)
    messages = [
        ("/odom", 100.0, m.odometry(100.0, m.pose(1.0))),
        ("/tf", 100.1, m.transforms([(100.1, "map", "odom", m.pose(5.0, 1.0, yaw=np.pi / 2))])),
        ("/tf", 100.1, m.transforms([(100.1, "odom", "base_link", m.pose(1.0))])),
        ("/marks", 100.2, m.markers(100.2, [("door", 1, 0, m.pose(5.0, 3.0))], "map")),
    ]
    (_, door), _ = read(m.bag(tmp_path / "map", messages, mcap=True), ".mcap")
    assert (door.frame, door.sightings[0].xyz_m) == ("odom", pytest.approx((2.0, 0.0, 0.0)))


def turning(m, time_s):
    """A camera on a robot that drives on a circle: its transforms and where it is, by the time."""
    angle = 0.4 * (time_s - 100.0)
    body = m.pose(5 * math.sin(angle), 5 - 5 * math.cos(angle), yaw=angle)
    mast = m.pose(0.0, 0.0, 1.0, yaw=-angle)
    return [(time_s, "odom", "base_link", body), (time_s, "base_link", "mast", mast)]


@KINDS
def test_transforms_are_interpolated_between_their_stamps(ros, tmp_path, ros1, mcap, suffix) -> None:
    m = ros(ros1)
    messages = [("/odom", 100.0, m.odometry(100.0, m.pose(0.0)))]
    messages += [("/tf", t, m.transforms(turning(m, t))) for t in np.arange(100.0, 104.01, 0.5).tolist()]
    messages += [
        ("/seen", t, m.detections(t, [("a", "car", 1.0, m.pose(2.0))], "mast"))
        for t in (100.0, 100.25, 101.6, 103.9, 104.2, 120.0)
    ]
    messages.sort(key=lambda one: one[1])
    path = m.bag(tmp_path / f"turn{suffix if ros1 else ''}", messages, mcap=mcap)
    pieces, findings = read(path, suffix)
    objects = [piece for piece in pieces if isinstance(piece, RobotObjects)]
    assert {piece.frame for piece in objects} == {"odom"}
    for piece in objects:
        (seen,) = piece.sightings
        angle = 0.4 * (min(seen.time_s, 104.0) - 100.0)  # the mast looks east all the time
        truth = (5 * math.sin(angle) + 2, 5 - 5 * math.cos(angle), 1.0)
        assert seen.xyz_m == pytest.approx(truth, abs=5 * 0.1**2 / 2 + 1e-6), seen.time_s  # chord and arc
    assert [(one.reason, one.count) for one in findings.doubts() if "transform" in one.reason] == [
        ("objects seen when a transform was not known: the nearest in time was taken", 1)
    ]


def test_long_before_the_first_transform_nothing_is_known_and_across_a_gap_the_nearest_counts(ros, tmp_path):
    m = ros(True)
    times = {200.0: 1.0, 260.0: 3.0}
    messages = [("/odom", 100.0, m.odometry(100.0, m.pose(0.0)))]
    messages += [("/tf", t, m.transforms([(t, "base_link", "arm", m.pose(x))])) for t, x in times.items()]
    seen = [("a", "car", 1.0, m.pose(0.0))]
    messages += [("/seen", t, m.detections(t, seen, "arm")) for t in (150.0, 195.0, 229.0, 231.0)]
    pieces, _ = read(m.bag(tmp_path / "gap.bag", sorted(messages, key=lambda one: one[1])), ".bag")
    objects = [piece for piece in pieces if isinstance(piece, RobotObjects)]
    assert [(one.frame, one.sightings[0].xyz_m[0]) for one in objects] == [
        ("arm", 0.0),
        ("base_link", 1.0),
        ("base_link", 1.0),
        ("base_link", 3.0),
    ]


def test_many_transforms_are_thinned_and_still_right(monkeypatch) -> None:
    monkeypatch.setattr(bag_frames, "_MOST_KEPT", 100)
    tree = FrameTree()
    for n in range(1000):
        tree.add(one_transform(n * 0.1, x=n * 0.1), recorded_s=n * 0.1, static=False)
    for time_s in (0.3, 33.33, 77.7):
        _, transform, outside_s = tree.nearest("b", time_s=time_s, fixed={"a"}, bodies=())
        assert (transform[0, 3], outside_s) == (pytest.approx(time_s, abs=1e-9), 0.0)


def one_transform(time_s, *, x):
    """A message with the transform of the frame b in a."""
    stamp = SimpleNamespace(sec=int(time_s), nanosec=round(time_s % 1 * 1e9))
    header = SimpleNamespace(frame_id="a", stamp=stamp)
    where = SimpleNamespace(
        translation=SimpleNamespace(x=x, y=0.0, z=0.0), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    return SimpleNamespace(transforms=[SimpleNamespace(header=header, child_frame_id="b", transform=where)])


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_orientations_are_interpolated_on_the_shorter_arc(share) -> None:
    def about_z(degrees):
        return np.array([0.0, 0.0, math.sin(math.radians(degrees) / 2), math.cos(math.radians(degrees) / 2)])

    for sign in (1.0, -1.0):
        found = slerp(about_z(170), sign * about_z(-170), share=share)
        assert abs(found @ about_z(170 + 20 * share)) == pytest.approx(1.0, abs=1e-12)


def test_transforms_that_are_none_are_not_taken(ros, tmp_path) -> None:
    m = ros(True)
    nowhere = m.pose(math.nan)
    unturned = m.make("geometry_msgs/msg/Pose", m.pose(1.0).position, m.make(
        "geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 0.0
    ))  # fmt: skip
    messages = [
        ("/odom", 100.0, m.odometry(100.0, m.pose(1.0))),
        (
            "/tf",
            100.1,
            m.transforms([(100.1, "base_link", "a", nowhere), (100.1, "base_link", "b", unturned)]),
        ),
        ("/seen", 100.2, m.detections(100.2, [("a", "car", 1.0, m.pose(2.0))], "a")),
        ("/seen", 100.3, m.detections(100.3, [("b", "car", 1.0, m.pose(2.0))], "b")),
    ]
    pieces, _ = read(m.bag(tmp_path / "n.bag", messages), ".bag")
    assert [piece.frame for piece in pieces[1:]] == ["a", "b"]


PLANS = [
    "/plan",
    "/robot1/local_plan",
    "/goal_pose",
    "/move_base_simple/goal",
    "/initialpose",
    "/setpoint/raw",
]


@pytest.mark.parametrize("topic", PLANS)
def test_planned_poses_are_not_odometry(ros, tmp_path, topic) -> None:
    m = ros(True)
    plan = m.path([m.stamped(1.0 + n, m.pose(100.0 * n)) for n in range(4)])
    stamped = m.stamped(1.0, m.pose(900.0))
    transform = ("/tf", 1.0, m.transforms([(1.0, "odom", "base_link", m.pose(1.0))]))
    messages = [(topic, 2.0, plan if topic.endswith("plan") else stamped)]
    path = m.bag(tmp_path / "p.bag", [transform, *messages])
    pieces, findings = read(path, ".bag")
    assert [piece.track for piece in pieces] == ["/tf"], "the plan does not replace the transforms"
    assert [(one.reason, one.where, one.count) for one in findings.skipped()] == [(rosbag.PLANNED, topic, 1)]
    assert {piece.track for piece in read(path, ".bag", (topic,))[0]} == {topic}, "if asked for"
    with pytest.raises(TrackError, match="no topic with poses") as error:
        read(m.bag(tmp_path / "only.bag", messages), ".bag")
    assert topic in error.value.hint


def test_a_definition_that_nobody_understands_does_no_harm_if_it_is_not_used(ros, tmp_path) -> None:
    m = ros(False)
    quaternion = m.pose(1.0).orientation
    path = m.bag(
        tmp_path / "bag", [("/fix", 1.0, m.fix(1.0, 50.0, 14.0)), ("/q", 1.0, quaternion)], mcap=True
    )
    data = path.read_bytes()
    assert data.count(b"float64 w") == 2, "in the data and in the summary"
    path.write_bytes(data.replace(b"float64 w", b"flo!t64&w"))
    pieces, findings = read(path, ".mcap")
    assert [piece.track for piece in pieces] == ["/fix"]
    assert [one.where for one in findings.skipped()] == ["/q"]
