"""What a robot publishes arrives at the server once, through cuts of the network and kills of the bridge."""

import functools
import hashlib
import itertools
import math
import os
import subprocess
import sys

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, NavSatFix
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros import mission_bridge
from expmap_ros.mission_bridge import MissionBridge
from expmap_ros.parameters import ParameterError
from ros.expmap_ros.test.support import LAT, LON
from ros.run_tests import ROOT
from tests.robot.stand_in import StandIn
from webapp.robot.client import RobotClient

COUNT, KILLS = 200, 3
KEPT = QoSProfile(
    depth=COUNT, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def header(number, frame="odom"):
    return Header(stamp=Time(sec=1000 + number), frame_id=frame)


def fix(number):
    message = NavSatFix(header=header(number, "gps"), latitude=LAT + number * 1e-5, longitude=LON)
    message.altitude = math.nan
    message.position_covariance = [4.0, 0.5, 0.0, 0.5, 9.0, 0.0, 0.0, 0.0, 25.0]
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_KNOWN
    return message


@pytest.fixture
def server():
    with StandIn() as running:
        yield running


@pytest.fixture
def values(server, tmp_path):
    """Parameters of a bridge."""
    (tmp_path / "token").write_text("secret")
    return {
        "server_url": server.url,
        "token_file": str(tmp_path / "token"),
        "mission": 7,
        "spool": str(tmp_path / "spool"),
    }


def records(server):
    return [r for stored in server.records.values() for r in stored]


def has_records(server, count):
    return len(records(server)) >= count


def command(values):
    """A bridge as a program, which is sent again what it may have missed."""
    qos = ("durability:=transient_local", f"depth:={COUNT}")
    words = [f"{name}:={value}" for name, value in values.items()]
    words += [f"qos_overrides./fix.subscription.{policy}" for policy in qos]
    given = [part for word in words for part in ("-p", word)]
    return [sys.executable, "-m", "expmap_ros.mission_bridge", "--ros-args", *given]


def test_every_message_once_through_cuts_and_kills(bench, server, values):
    server.script = lambda path, body: (0, {}, {}) if len(server.requests) % 3 == 0 else None  # cut
    environ = {**os.environ, "PYTHONPATH": f"{ROOT / 'ros' / 'expmap_ros'}{os.pathsep}{ROOT}"}
    publisher = bench.node.create_publisher(NavSatFix, "/fix", KEPT)
    numbers = iter(range(COUNT))
    bridge = subprocess.Popen(command(values), env=environ)
    try:
        for kill in range(KILLS):
            for number in itertools.islice(numbers, COUNT // (KILLS + 1)):
                publisher.publish(fix(number))
            wanted = kill * COUNT // (KILLS + 1) + 5
            bench.until(functools.partial(has_records, server, wanted))
            bridge.kill()  # SIGKILL, while more is under way
            bridge.wait()
            bridge = subprocess.Popen(command(values), env=environ)
        for number in numbers:
            publisher.publish(fix(number))
        bench.until(functools.partial(has_records, server, COUNT))
    finally:
        bridge.kill()
        bridge.wait()
    assert [record["time"] for record in records(server)] == [1000.0 + number for number in range(COUNT)]
    first = records(server)[0]
    assert (first["source"], first["lat"], first["covariance"]) == ("gps", LAT, [4.0, 9.0, 0.5])


def test_a_clock_that_is_set_back_loses_nothing(bench, server, values):
    bench.start(MissionBridge, **values)
    publisher = bench.node.create_publisher(NavSatFix, "/fix", 10)
    later, earlier = fix(500), fix(3)
    bench.until(lambda: records(server), lambda: publisher.publish(later))
    bench.until(lambda: has_records(server, 2), lambda: publisher.publish(earlier))
    assert [record["time"] for record in records(server)] == [1500.0, 1003.0]


def test_stamps_before_what_was_sent_by_an_earlier_run_are_a_warning(bench, server, values, monkeypatch):
    with RobotClient(
        server.url, "secret", mission=7, spool=values["spool"], about="mission_bridge"
    ) as earlier:
        earlier.pose(LAT, LON, time_s=2000.0, source="gps")
    monkeypatch.setattr(mission_bridge, "_CATCH_UP_S", 0.0)
    bench.start(MissionBridge, **values)
    publisher = bench.node.create_publisher(NavSatFix, "/fix", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    bench.until(
        lambda: any(s.status[0].message == mission_bridge._BEHIND for s in states),
        lambda: publisher.publish(fix(3)),
    )
    bench.until(lambda: has_records(server, 2), lambda: publisher.publish(fix(1001)))
    assert [record["time"] for record in records(server)] == [2000.0, 2001.0]


def test_odometry_objects_and_their_images(bench, server, values):
    bench.start(MissionBridge, **values, start=f"{LAT},{LON},90")
    odometry = bench.node.create_publisher(Odometry, "/odom", 10)
    objects = bench.node.create_publisher(MarkerArray, "/objects", 10)
    images = bench.node.create_publisher(CompressedImage, "/objects/image/compressed", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    moved = Odometry(header=header(1), child_frame_id="base_link")
    moved.pose.pose.position.x = 10.0  # ahead: the robot looks east at the start
    moved.pose.pose.orientation.z = moved.pose.pose.orientation.w = math.sqrt(0.5)  # and to the left now
    moved.pose.covariance[0], moved.pose.covariance[7] = 1.0, 4.0
    bench.until(lambda: records(server), lambda: odometry.publish(moved))
    image = CompressedImage(header=header(2, "camera"), format="jpeg", data=b"no real photo")

    def has_image():
        waiting = [v.value for s in states for v in s.status[0].values if v.key == "photos waiting"]
        return waiting and int(waiting[-1]) > 0

    server.script = lambda path, body: (0, {}, {}) if "form" in body else None
    bench.until(has_image, lambda: images.publish(image))
    seen = Marker(header=header(2, "base_link"), ns="car", id=3, type=Marker.CUBE)
    seen.pose.position.x = 5.0
    gone = Marker(header=header(2), ns="car", id=4, action=Marker.DELETE)
    both = MarkerArray(markers=[seen, gone])
    bench.until(lambda: len(records(server)) == 2, lambda: objects.publish(both))
    pose, car = records(server)
    assert (pose["source"], pose["lat"]) == ("odometry", pytest.approx(LAT, abs=1e-9))
    assert (pose["lon"] - LON) * math.cos(math.radians(LAT)) * 111_320 == pytest.approx(10.0, rel=5e-3)
    assert pose["heading_deg"] == pytest.approx(0.0, abs=1e-6)
    assert pose["covariance"] == pytest.approx([1.0, 4.0, 0.0])
    assert (car["id"], car["class"], car["lon"]) == ("car/3", "car", pytest.approx(pose["lon"], abs=1e-9))
    assert (car["lat"] - LAT) * 111_240 == pytest.approx(5.0, rel=5e-3)
    assert car["photo"] == hashlib.sha256(b"no real photo").hexdigest()
    end = bench.node.create_client(Trigger, "/mission_bridge/end")
    assert end.wait_for_service(timeout_sec=60)
    done = end.call_async(Trigger.Request())
    bench.until(done.done)
    bench.until(lambda: [r["type"] for r in records(server)] == ["pose", "object", "end"])


def test_what_cannot_be_used_is_told(bench, server, values):
    bench.start(MissionBridge, **values)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    fixes = bench.node.create_publisher(NavSatFix, "/fix", 10)
    lost = fix(1)
    lost.status.status = -1
    wrong = fix(2)
    wrong.latitude = 91.0

    def again():
        fixes.publish(lost)
        fixes.publish(wrong)

    def told():
        return [s for s in states if s.status[0].level == DiagnosticStatus.ERROR]

    bench.until(told, again)
    assert "lat" in told()[0].status[0].message
    assert records(server) == []


@pytest.mark.parametrize("missing", ["mission", "spool", "server_url", "token_file"])
def test_what_is_missing_is_named(bench, values, missing):
    del values[missing]
    with pytest.raises(ParameterError, match=missing):
        bench.start(MissionBridge, **values)


def test_a_start_that_is_none_is_named(bench, values):
    with pytest.raises(ParameterError, match=r"start: write LAT,LON,HEADING, not '50,14'"):
        bench.start(MissionBridge, **values, start="50,14")
