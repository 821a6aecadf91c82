"""Answers become poses of a robot, pictures and markers."""

import json
import math

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Image
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros.fix_bridge import FixBridge
from expmap_ros.parameters import ParameterError
from expmap_ros.pictures import pixels_of
from expmap_ros.running import KEPT
from expmap_ros.visualizer import Visualizer
from ros.expmap_ros.test.support import LAT, LON
from webapp.render.colours import probability_colour

AXIS = 1.0 / math.sqrt(-2.0 * math.log(0.32))


def answer(*, second=5, probability=0.9, radius_m=2.0, heading=90.0):
    place = {
        "x_px": 300.0, "y_px": 100.0, "radius_px": 28.0, "radius_m": radius_m, "heading_deg": heading,
        "lat": LAT, "lon": LON, "probability": probability, "experiences": [2], "matches": 80,
    }  # fmt: skip
    rest = {"other_probability": 0.0, "off_map_probability": 1.0 - probability}
    rest["verdict"] = "place" if probability >= 0.5 else "off_map"
    return String(data=json.dumps({"stamp": {"sec": second, "nanosec": 0}, "hypotheses": [place], **rest}))


def test_a_sure_answer_is_the_pose_of_the_robot_and_others_are_left_out(bench):
    bench.start(FixBridge, origin=f"{LAT},{LON}", camera="1,0,180", covariance_scale=4.0)
    poses = bench.listen(PoseWithCovarianceStamped, "/visual_pose")
    source = bench.node.create_publisher(String, "/pose_estimator/answer", 10)

    def again():
        source.publish(answer(second=1, probability=0.6))
        source.publish(answer(second=2, radius_m=30.0))
        source.publish(answer(second=3, probability=0.4))
        source.publish(answer(second=5))

    bench.until(lambda: len(poses) >= 2, again)
    assert {pose.header.stamp.sec for pose in poses} == {5}
    pose = poses[0].pose
    # the camera looks back, to the east, and is 1 m in front: the robot looks west, and is 1 m east of it
    assert (pose.pose.position.x, pose.pose.position.y) == pytest.approx((1.0, 0.0), abs=1e-9)
    assert abs(pose.pose.orientation.z) == pytest.approx(1.0)
    assert pose.covariance[0] == pytest.approx(4.0 * (2.0 * AXIS) ** 2)


def test_without_a_direction_the_robot_is_around_the_camera(bench):
    bench.start(FixBridge, origin=f"{LAT},{LON}", camera="3,4,0")
    poses = bench.listen(PoseWithCovarianceStamped, "/visual_pose")
    source = bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    unknown = answer(heading=None)
    bench.until(lambda: poses, lambda: source.publish(unknown))
    assert poses[0].pose.covariance[0] == pytest.approx((2.0 * AXIS) ** 2 + 25.0)
    assert poses[0].pose.covariance[35] > 9


def test_the_bridge_needs_an_origin(bench):
    with pytest.raises(ParameterError, match="origin"):
        bench.start(FixBridge)


def of(namespace, message):
    return [m for m in message.markers if m.ns == namespace and m.action == Marker.ADD]


def test_an_answer_is_shown_on_the_map(bench, survey):
    bench.start(Visualizer, map_file=str(survey / "map.cfg"))
    pictures = bench.listen(Image, "/visualizer/map", KEPT)
    markers = bench.listen(MarkerArray, "/visualizer/markers", KEPT)
    bench.until(lambda: pictures and markers)
    assert len(of("experiences", markers[0])[0].points) == 6 and of("hypotheses", markers[0]) == []
    empty = pixels_of(pictures[0])
    source = bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    shown = answer()
    bench.until(lambda: of("hypotheses", markers[-1]), lambda: source.publish(shown))
    (disc,), (arrow,) = of("hypotheses", markers[-1]), of("headings", markers[-1])
    assert disc.scale.x == pytest.approx(4.0) and disc.header.stamp.sec == 5
    colour = probability_colour(0.9)
    assert (disc.color.r, disc.color.g, disc.color.b) == pytest.approx([c / 255 for c in colour])
    assert (arrow.pose.orientation.z, arrow.pose.orientation.w) == pytest.approx((0.0, 1.0)), "east"
    bench.until(lambda: (pixels_of(pictures[-1]) == colour).all(axis=2).sum() > 100)
    assert empty.shape[2] == 3 and (empty == colour).all(axis=2).sum() < 100


def test_the_same_answer_is_shown_on_another_placement_by_its_photo(bench, survey):
    placement = survey / "clusters.cfg"
    text = (survey / "map.cfg").read_text()
    placement.write_text(text.replace(";300;100", ";500;150"))
    assert placement.read_text() != text
    bench.start(Visualizer, map_file=str(placement), place_by="photo", metres_per_pixel=0.1)
    markers = bench.listen(MarkerArray, "/visualizer/markers", KEPT)
    source = bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    shown = answer()
    bench.until(lambda: markers and of("hypotheses", markers[-1]), lambda: source.publish(shown))
    moved = of("hypotheses", markers[-1])[0].pose.position
    assert (moved.x, moved.y) == pytest.approx((50.0, -15.0))
    assert of("headings", markers[-1]) == []
