"""Messages of a robot reach the server exactly once, despite network cuts and kills of the bridge."""

import functools
import hashlib
import math
import os
import subprocess
import sys
from collections import Counter

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, CompressedImage, NavSatFix
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from expmap_ros.mission_bridge import MissionBridge
from expmap_ros.parameters import ParameterError
from ros.expmap_ros.test.support import LAT, LON, header, records
from ros.run_tests import ROOT
from webapp.robot.client import RobotClient

COUNT, KILLS, CUTS = 60, 5, 10
TOPICS = ("/fix", "/odom", "/objects")
KEPT = QoSProfile(
    depth=COUNT, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def fix(number):
    message = NavSatFix(header=header(number, "gps"), latitude=LAT + number * 1e-5, longitude=LON)
    message.altitude = math.nan
    message.position_covariance = [4.0, 0.5, 0.0, 0.5, 9.0, 0.0, 0.0, 0.0, 25.0]
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_KNOWN
    return message


def has_records(server, count):
    return len(records(server)) >= count


def command(values):
    """Return the command of a bridge; with its QoS, publishers resend what it may have missed."""
    qos = ("durability:=transient_local", f"depth:={COUNT}")
    words = [f"{name}:={value}" for name, value in values.items()]
    words += [f"qos_overrides.{topic}.subscription.{policy}" for topic in TOPICS for policy in qos]
    given = [part for word in words for part in ("-p", word)]
    return [sys.executable, "-m", "expmap_ros.mission_bridge", "--ros-args", *given]


def odometry_at(number):
    message = Odometry(header=header(number), child_frame_id="base_link")
    message.pose.pose.position.x, message.pose.pose.orientation.w = float(number), 1.0
    return message


def unstamped_marker(number):
    seen = Marker(header=Header(frame_id="odom"), ns="car", id=number, type=Marker.CUBE)
    return MarkerArray(markers=[seen])


def saying(states, key):
    """Return a value of the newest diagnostics as a list, empty before there are any."""
    return [int(v.value) for state in states[-1:] for v in state.status[0].values if v.key == key]


def test_every_message_once_through_cuts_and_kills_however_late_it_is(bench, server, values):
    cut, block = Counter(), 0

    def reply(path, body):
        """Cut two requests of each block: one before and one after it is stored."""
        if cut[block] == CUTS / KILLS:
            return None
        cut[block] += 1
        if cut[block] % 2 == 0:
            server.store(body)  # but the answer is lost
        return 0, {}, {}

    server.script = reply
    makers = {"/fix": fix, "/odom": odometry_at, "/objects": unstamped_marker}
    topics = [(bench.node.create_publisher(type(make(0)), t, KEPT), make) for t, make in makers.items()]
    environ = {**os.environ, "PYTHONPATH": f"{ROOT / 'ros' / 'expmap_ros'}{os.pathsep}{ROOT}"}
    start = command({**values, "start": f"'{LAT},{LON},90'"})
    size = COUNT // (KILLS + 1)
    states = bench.listen(DiagnosticArray, "/diagnostics")
    bridge = subprocess.Popen(start, env=environ)
    try:
        for block in range(KILLS + 1):
            for number in range((block + 1) * size - 1, block * size - 1, -1):  # the newest first
                for publisher, make in topics:
                    publisher.publish(make(number))
            bench.until(functools.partial(has_records, server, 3 * block * size + 5))
            bridge.kill()  # SIGKILL, while more messages are being processed
            bridge.wait()
            bridge = subprocess.Popen(start, env=environ)
        bench.until(functools.partial(has_records, server, 3 * COUNT))
        states.clear()
        bench.until(
            lambda: saying(states, "received") == [3 * COUNT] and saying(states, "records waiting") == [0]
        )
    finally:
        bridge.kill()
        bridge.wait()
    assert cut.total() >= CUTS
    poses = Counter((r["source"], r["time"]) for r in records(server) if r["type"] == "pose")
    assert poses == Counter((s, 1000.0 + n) for s in ("gps", "odometry") for n in range(COUNT))
    seen = Counter(r["id"] for r in records(server) if r["type"] == "object")
    assert seen == Counter(f"car/{number}" for number in range(COUNT))
    first = next(r for r in records(server) if (r.get("source"), r["time"]) == ("gps", 1000.0))
    assert (first["lat"], first["covariance"]) == (LAT, [4.0, 9.0, 0.5])


def test_a_clock_that_is_set_back_loses_nothing(bench, server, values):
    bench.start(MissionBridge, **values)
    publisher = bench.node.create_publisher(NavSatFix, "/fix", 10)
    later, earlier = fix(500), fix(3)
    bench.until(lambda: records(server), lambda: publisher.publish(later))
    bench.until(lambda: has_records(server, 2), lambda: publisher.publish(earlier))
    assert [record["time"] for record in records(server)] == [1500.0, 1003.0]


def test_the_battery_is_reported_when_it_changes(bench, server, values):
    bench.start(MissionBridge, **values)
    publisher = bench.node.create_publisher(BatteryState, "/battery_state", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")

    def publish(number, share):
        publisher.publish(BatteryState(header=header(number), percentage=share))

    bench.until(lambda: records(server), lambda: publish(0, 0.8))
    publish(1, math.nan)
    bench.until(lambda: has_records(server, 2), lambda: publish(2, 0.79))
    bench.until(lambda: sum(saying(states, "unusable")), lambda: publish(3, 79.0))
    found = [(record["type"], record["time"], record["battery_percent"]) for record in records(server)]
    assert found == [("status", 1000.0, 80.0), ("status", 1002.0, 79.0)]


def test_the_quality_of_one_topic_is_not_that_of_others(bench, server, values):
    kept = {"qos_overrides./fix.subscription.durability": "transient_local"}
    bench.start(MissionBridge, **values, **kept, start=f"{LAT},{LON},90")
    publisher = bench.node.create_publisher(Odometry, "/odom", 10)  # keeps nothing
    bench.until(lambda: records(server), lambda: publisher.publish(odometry_at(1)))
    assert records(server)[0]["source"] == "odometry"


def test_what_was_never_sent_arrives_however_late_it_is(bench, server, values):
    with RobotClient(
        server.url, "secret", mission=7, spool=values["spool"], about="mission_bridge"
    ) as earlier:
        earlier.pose(LAT, LON, time_s=2000.0, source="gps")
        earlier.pose(LAT + 5e-5, LON, time_s=1005.0, source="gps")
    bench.start(MissionBridge, **values)
    publisher = bench.node.create_publisher(NavSatFix, "/fix", 10)
    states = bench.listen(DiagnosticArray, "/diagnostics")

    def again():
        for number in (5, 3):
            publisher.publish(fix(number))

    bench.until(lambda: has_records(server, 3) and sum(saying(states, "repeated")) >= 2, again)
    assert [record["time"] for record in records(server)] == [2000.0, 1005.0, 1003.0]


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
