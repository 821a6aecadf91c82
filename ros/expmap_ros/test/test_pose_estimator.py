"""Images are answered with places, or with "not on this map"."""

import json
import math

import cv2
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CompressedImage, Image, NavSatFix
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from expmap_ros.messages import POSES_IN_MAP
from expmap_ros.parameters import ParameterError
from expmap_ros.pictures import image_of
from expmap_ros.pose_estimator import PoseEstimator
from ros.expmap_ros.test.support import LAT, LON, ids_and_probabilities, textured

STAMP = Time(sec=1432235498, nanosec=40_000_000)
HEADER = Header(stamp=STAMP, frame_id="camera")


def raw(pixels):
    return image_of(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), HEADER)


def compressed(pixels):
    data = cv2.imencode(".jpg", pixels)[1].tobytes()
    return CompressedImage(header=HEADER, format="jpeg", data=data)


def test_an_image_becomes_a_pose_a_fix_and_a_picture(bench, survey):
    bench.start(PoseEstimator, map_file=str(survey / "map.cfg"), fov_deg=60.0)
    camera = bench.node.create_publisher(Image, "/gscam/image_raw", 1)
    poses = bench.listen(PoseWithCovarianceStamped, "/pose_estimator/pose")
    fixes = bench.listen(NavSatFix, "/pose_estimator/fix")
    lists = bench.listen(POSES_IN_MAP, "/poses_in_map")
    texts = bench.listen(String, "/pose_estimator/answer")
    pictures = bench.listen(Image, "/keypoint_matches")
    states = bench.listen(DiagnosticArray, "/diagnostics")
    message = raw(textured(2))
    bench.until(lambda: poses and fixes and lists and texts and pictures, lambda: camera.publish(message))
    pose, fix = poses[0], fixes[0]
    assert (pose.header.stamp, pose.header.frame_id) == (STAMP, "map")
    assert fix.header == HEADER
    # the third photo is half the spacing of the photos left of the centre of the image
    assert math.hypot(pose.pose.pose.position.x + 50 * 0.07, pose.pose.pose.position.y) < 3.5
    assert math.hypot((fix.latitude - LAT + 0.000063) * 111e3, (fix.longitude - LON - 0.000294) * 71e3) < 3.5
    assert (
        pose.pose.covariance[0] == pytest.approx(fix.position_covariance[0], rel=1e-6)
        and fix.position_covariance[0] > 0
    )
    (ids, probabilities), answer = ids_and_probabilities(lists[0]), json.loads(texts[0].data)
    assert ids[0] == 2 and probabilities[0] > 0.5
    assert [h["probability"] for h in answer["hypotheses"]] == pytest.approx(probabilities, rel=1e-6)
    assert answer["stamp"] == {"sec": STAMP.sec, "nanosec": STAMP.nanosec}
    assert pictures[0].width > 320 and pictures[0].header == HEADER
    bench.until(lambda: states and states[-1].status[0].level == DiagnosticStatus.OK)
    assert states[-1].status[0].message.startswith("at ")


def test_images_of_a_sequence_are_localized_by_those_before(bench, survey):
    bench.start(PoseEstimator, map_file=str(survey / "map.cfg"), fov_deg=60.0, sequence=True)
    camera = bench.node.create_publisher(Image, "/gscam/image_raw", 1)
    texts = bench.listen(String, "/pose_estimator/answer")
    message = raw(textured(3))
    bench.until(lambda: len(texts) >= 2, lambda: camera.publish(message))
    answers = [json.loads(text.data) for text in texts]
    assert all(answer["sequence"] and answer["hypotheses"][0]["experiences"][0] == 3 for answer in answers)
    first, second = (answer["hypotheses"][0]["probability"] for answer in answers[:2])
    assert second != first, "the same image, but not the same answer: there was one before"


def test_elsewhere_is_no_pose_but_a_warning_and_the_service_says_the_same(bench, survey):
    bench.start(PoseEstimator, map_file=str(survey / "map.cfg"), image_transport="compressed", fov_deg=60.0)
    camera = bench.node.create_publisher(CompressedImage, "/gscam/image_raw/compressed", 1)
    client = bench.node.create_client(Trigger, "/pose_estimator/where_am_i")
    assert client.wait_for_service(timeout_sec=60)
    early = client.call_async(Trigger.Request())
    bench.until(early.done)
    assert not early.result().success
    poses = bench.listen(PoseWithCovarianceStamped, "/pose_estimator/pose")
    texts = bench.listen(String, "/pose_estimator/answer")
    states = bench.listen(DiagnosticArray, "/diagnostics")
    elsewhere = compressed(textured(77))
    bench.until(lambda: texts, lambda: camera.publish(elsewhere))
    bench.until(lambda: states and "not on this map" in states[-1].status[0].message)
    assert states[-1].status[0].level == DiagnosticStatus.WARN
    assert poses == []
    now = client.call_async(Trigger.Request())
    bench.until(now.done)
    answer = json.loads(now.result().message)
    best = max((h["probability"] for h in answer["hypotheses"]), default=0.0)
    assert now.result().success and answer["off_map_probability"] > best


def test_an_unreadable_image_is_an_error_and_the_next_one_is_answered(bench, survey):
    bench.start(PoseEstimator, map_file=str(survey / "map.cfg"), fov_deg=60.0)
    camera = bench.node.create_publisher(Image, "/gscam/image_raw", 1)
    texts = bench.listen(String, "/pose_estimator/answer")
    states = bench.listen(DiagnosticArray, "/diagnostics")
    bad = Image(header=HEADER, height=2, width=2, step=6, encoding="bayer_rggb8", data=bytes(12))

    def failed():
        return states and states[-1].status[0].level == DiagnosticStatus.ERROR

    bench.until(failed, lambda: camera.publish(bad))
    assert "bayer_rggb8" in states[-1].status[0].message
    good = raw(textured(4))
    bench.until(lambda: texts, lambda: camera.publish(good))
    assert json.loads(texts[0].data)["hypotheses"][0]["experiences"][0] == 4


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({}, "map_file, server_url"),
        ({"map_file": "nowhere.cfg"}, "nowhere.cfg"),
        ({"map_file": "CFG", "fov_deg": 200.0}, "fov_deg"),
        ({"map_file": "CFG", "top": "many"}, "top"),
        ({"map_file": "CFG", "image_transport": "pigeon"}, "image_transport"),
        ({"map_file": "CFG", "origin": "50"}, "origin"),
        ({"server_url": "http://127.0.0.1:1"}, "map_name"),
        ({"server_url": "http://127.0.0.1:1", "map_name": "park"}, "token_file"),
    ],
)
def test_a_wrong_parameter_is_named_at_the_start(bench, survey, values, named):
    cfg = str(survey / "map.cfg")
    with pytest.raises(ParameterError, match=named):
        bench.start(PoseEstimator, **{name: cfg if v == "CFG" else v for name, v in values.items()})
