"""The transform from map to odometry: only from reliable answers, at their time, for a limited time."""

import math

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header, String

from expmap_ros.fix_bridge import FixBridge
from expmap_ros.messages import rotation, yaw_of
from expmap_ros.odometry_frame import Planar, PoseHistory, map_to_odometry
from expmap_ros.parameters import ParameterError
from ros.expmap_ros.test.support import LAT, LON
from ros.expmap_ros.test.test_answers_shown import answer

TFMessage = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built here").TFMessage


def moved(seconds, x, y, yaw):
    header = Header(stamp=Time(sec=seconds), frame_id="odom")
    one = TransformStamped(header=header, child_frame_id="base_link")
    one.transform.translation.x, one.transform.translation.y = x, y
    one.transform.rotation = rotation(yaw)
    return TFMessage(transforms=[one])


def test_sure_answers_say_where_odometry_is_on_the_map_and_not_for_long(bench):
    values = {"origin": f"{LAT},{LON}", "tf": "odom,base_link", "tf_age_s": 30.0}
    bridge = bench.start(FixBridge, **values, use_sim_time=True)
    clock = bench.node.create_publisher(Clock, "/clock", 10)
    transforms = bench.node.create_publisher(TFMessage, "/tf", 10)
    answers = bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    heard = bench.listen(TFMessage, "/tf")

    def corrections(after_s=0):
        found = [t for m in heard for t in m.transforms if t.header.frame_id == "map"]
        return [t for t in found if t.header.stamp.sec >= after_s]

    def set_clock(tenths):
        now = Clock(clock=Time(sec=tenths // 10, nanosec=tenths % 10 * 100_000_000))
        bench.until(
            lambda: bridge.get_clock().now().nanoseconds == tenths * 100_000_000, lambda: clock.publish(now)
        )

    # at 5 s the odometry is (4, 2), facing along y
    tenths = iter(range(50, 300))
    ways = [moved(4, 3.0, 2.0, math.pi / 2), moved(5, 4.0, 2.0, math.pi / 2)]
    told = [answer(second=4, probability=0.6, heading=10.0), answer(second=4, heading=None)]
    told.append(answer(second=5, heading=90.0))

    def tell():
        for way in ways:
            transforms.publish(way)
        for one in told:
            answers.publish(one)
        set_clock(next(tenths))

    bench.until(corrections, tell)
    for one in corrections():
        # the robot is at the origin and faces east, so the odometry frame is rotated by 90 degrees clockwise
        at = one.transform.translation
        assert one.child_frame_id == "odom"
        assert (at.x, at.y) == pytest.approx((-2.0, 4.0), abs=1e-6)
        assert yaw_of(one.transform.rotation) == pytest.approx(-math.pi / 2)
        assert one.header.stamp.sec < 30, "of simulated time"

    for late in range(360, 370, 2):
        set_clock(late)
    assert corrections(after_s=36) == [], "the answer of 5 s is too old"
    tenths = iter(range(370, 600))
    ways, told = [moved(36, 0.0, 0.0, 0.0)], [answer(second=36, heading=0.0)]
    bench.until(lambda: corrections(after_s=36), tell)
    assert {round(yaw_of(t.transform.rotation), 6) for t in corrections(after_s=36)} == {1.570796}


def test_between_transforms_the_robot_is_interpolated_and_outside_nobody_knows():
    history = PoseHistory()
    history.add(4.0, Planar(0.0, 0.0, 3.0))
    history.add(4.5, Planar(1.0, 2.0, -3.0))
    history.add(9.0, Planar(9.0, 9.0, 0.0))
    half = history.at(4.25)
    assert (half.x, half.y) == pytest.approx((0.5, 1.0))
    assert math.cos(half.yaw) == pytest.approx(-1.0), "the short way around"
    assert [history.at(t) for t in (3.9, 6.0, 9.1)] == [None, None, None]
    assert history.at(9.0) == Planar(9.0, 9.0, 0.0)
    history.add(2.0, Planar(7.0, 7.0, 0.0))
    assert history.at(4.0) is None and history.at(2.0) == Planar(7.0, 7.0, 0.0), "the clock was set back"


def test_the_map_sees_the_robot_where_odometry_and_the_transform_say():
    in_map, in_odometry = Planar(10.0, -4.0, 2.0), Planar(3.0, 1.0, -0.5)
    again = map_to_odometry(in_map, in_odometry) @ in_odometry
    assert (again.x, again.y, again.yaw) == pytest.approx((10.0, -4.0, 2.0))


def test_frames_that_are_none_are_named(bench):
    with pytest.raises(ParameterError, match="tf: write ODOMETRY,ROBOT, not 'odom'"):
        bench.start(FixBridge, origin=f"{LAT},{LON}", tf="odom")
