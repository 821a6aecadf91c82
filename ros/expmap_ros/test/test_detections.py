"""Detections of vision_msgs become objects: 3D ones, and 2D ones by where they stand on the ground."""

import hashlib
import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image

from expmap_ros.ground import GroundCamera, Pinhole
from expmap_ros.mission_bridge import MissionBridge
from expmap_ros.parameters import ParameterError
from expmap_ros.pictures import png_of
from ros.expmap_ros.test.support import LAT, LON, header, records, textured

vision = pytest.importorskip("vision_msgs.msg", reason="vision_msgs is not built here")

NORTH_M, EAST_M = 111_240.0, 111_320.0 * math.cos(math.radians(LAT))
LENS = Pinhole(500.0, 500.0, 320.0, 240.0)


def hypothesis(kind, score):
    made = vision.ObjectHypothesisWithPose()
    made.hypothesis.class_id, made.hypothesis.score = kind, score
    return made


def solid(name, x, *, kind="victim"):
    made = vision.Detection3D(id=name, results=[hypothesis("dog", 0.2), hypothesis(kind, 0.75)])
    made.bbox.center.position.x = x
    return made


def flat(name, column, row, *, height=40.0):
    """Return a box whose lower edge is at `row`."""
    made = vision.Detection2D(id=name, results=[hypothesis("cone", 0.5)])
    made.bbox.center.position.x, made.bbox.center.position.y = column, row - height / 2
    made.bbox.size_x, made.bbox.size_y = 20.0, height
    return made


def at_rest(number):
    message = Odometry(header=header(number), child_frame_id="base_link")
    message.pose.pose.orientation.w = 1.0
    return message


@pytest.fixture
def robot(bench, server, values):
    """Start a bridge for a robot at the start that faces north, with a camera 1 m up that looks ahead."""
    bench.start(MissionBridge, **values, start=f"{LAT},{LON},0", camera="0.5,0,1,0,0", max_range_m=30.0)
    odometry = bench.node.create_publisher(Odometry, "/odom", 10)
    bench.until(lambda: records(server), lambda: odometry.publish(at_rest(1)))


def sent_objects(server):
    return [r for r in records(server) if r["type"] == "object"]


def objects(server):
    return {r["id"]: r for r in sent_objects(server)}


def saying(states, key):
    """Return a value of the newest diagnostics; 0 before there are any."""
    return sum(int(v.value) for state in states[-1:] for v in state.status[0].values if v.key == key)


def test_detections_in_space_are_objects_with_an_id_or_without(bench, server, robot):
    publisher = bench.node.create_publisher(vision.Detection3DArray, "/detections", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    bad = solid("far off", 3.0)
    bad.header.frame_id = "lidar"
    large = solid("", 2.0)
    large.bbox.size = Vector3(x=1.0, y=2.0, z=3.0)
    large.bbox.center.position.z = 0.5
    message = vision.Detection3DArray(
        header=header(2, "base_link"),
        detections=[bad, solid("", 1.0), large, solid("", 3.0), solid("v1", 8.0)],
    )
    bench.until(lambda: len(sent_objects(server)) >= 4, lambda: publisher.publish(message))
    seen = sent_objects(server)
    assert [one.get("id") for one in seen] == [None, None, None, "v1"]
    assert {(one["class"], one["confidence"], one["time"]) for one in seen} == {("victim", 0.75, 1002.0)}
    assert [one.get("size_m") for one in seen] == [None, [1.0, 2.0, 3.0], None, None]
    assert [one["height_m"] for one in seen] == [0.0, 0.5, 0.0, 0.0]
    assert [(one["lat"] - LAT) * NORTH_M for one in seen] == pytest.approx([1.0, 2.0, 3.0, 8.0], rel=1e-3)
    bench.until(
        lambda: any("far off" in s.status[0].message and "lidar" in s.status[0].message for s in states)
    )
    states.clear()
    bench.until(lambda: saying(states, "repeated") >= 8, lambda: publisher.publish(message))
    assert len(sent_objects(server)) == 4


def test_detections_in_an_image_are_objects_where_they_stand(bench, server, robot):
    publisher = bench.node.create_publisher(vision.Detection2DArray, "/detections_2d", 10)
    lens = bench.node.create_publisher(CameraInfo, "/detections_2d/camera_info", 10)
    images = bench.node.create_publisher(Image, "/objects/image", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    info = CameraInfo(header=header(2, "camera"), k=[500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0])
    picture = textured(1)[:20, :30]
    image = Image(header=header(2, "camera"), height=20, width=30, step=90, encoding="rgb8")
    image.data = picture.tobytes()
    message = vision.Detection2DArray(
        header=header(2, "camera"), detections=[flat("sky", 320.0, 200.0), flat("c1", 370.0, 290.0)]
    )

    def says(text):
        return any(text in s.status[0].message for s in states)

    server.script = lambda path, body: (0, {}, {}) if "form" in body else None
    bench.until(lambda: says("CameraInfo"), lambda: publisher.publish(message))

    def again():
        lens.publish(info)
        images.publish(image)
        publisher.publish(message)

    bench.until(lambda: objects(server) and says("sky does not stand on the ground within 30 m"), again)
    (seen,) = objects(server).values()
    # 50 pixels below the horizon with a focal length of 500: 10 m ahead of the camera, 1 m to its right
    assert (seen["id"], seen["class"], seen["confidence"]) == ("c1", "cone", 0.5)
    assert (seen["lat"] - LAT) * NORTH_M == pytest.approx(10.5, rel=1e-3)
    assert (seen["lon"] - LON) * EAST_M == pytest.approx(1.0, rel=5e-3)
    sent = hashlib.sha256(png_of(picture)).hexdigest()

    def shown():
        return [b for _, b in server.requests if ("form" in b and b"c1" in b["form"]) or sent in str(seen)]

    bench.until(shown, again)


@pytest.mark.parametrize("pitch", [0.0, 0.3])
def test_a_point_of_the_ground_is_found_again(pitch):
    camera = GroundCamera(0.5, 0.2, 1.2, pitch, math.radians(30))
    x, y = 6.0, 1.0  # relative to the camera: ahead, and left of its viewing direction
    ahead = x * math.cos(pitch) + camera.up * math.sin(pitch)
    below = camera.up * math.cos(pitch) - x * math.sin(pitch)
    column, row = LENS.cx - LENS.fx * y / ahead, LENS.cy + LENS.fy * below / ahead
    found = camera.on_ground(column, row, lens=LENS, farthest_m=50.0)
    c, s = math.cos(camera.yaw), math.sin(camera.yaw)
    assert found == pytest.approx((0.5 + c * x - s * y, 0.2 + s * x + c * y))
    assert camera.on_ground(column, row, lens=LENS, farthest_m=5.0) is None
    assert camera.on_ground(column, -10_000.0, lens=LENS, farthest_m=50.0) is None


def test_a_camera_in_the_ground_is_refused(bench, values):
    with pytest.raises(ParameterError, match="camera: UP has to be above the ground"):
        bench.start(MissionBridge, **values, camera="0,0,0,0,0")
