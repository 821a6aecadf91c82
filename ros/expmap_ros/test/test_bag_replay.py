"""Playing a bag to the bridge gives the same mission as importing the bag."""

import math
import threading
from collections import Counter

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import NavSatFix
from werkzeug.serving import make_server

from expmap_ros.mission_bridge import MissionBridge
from ros.expmap_ros.test.support import LAT, LON
from tests.missions.files.readers.conftest import Messages
from tests.robot.site import Site
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.store import tracks
from webapp.missions.store.schema import MissionObject
from webapp.missions.tasks.import_file import Order, import_track_file
from webapp.missions.tasks.place_track import ReadOptions
from webapp.settings import Settings

TFMessage = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built here").TFMessage
vision = pytest.importorskip("vision_msgs.msg", reason="vision_msgs is not built here")

FIELDS = ("kind", "sightings", "first_time_s", "last_time_s", "confidence", "size_m", "associated")
COUNT, BEGIN_S = 40, 1_777_629_600.0
MOVES = {"/fix": NavSatFix, "/odom": Odometry, "/tf": TFMessage}
KINDS = {**MOVES, "/detections": vision.Detection3DArray}
KEPT = QoSProfile(
    depth=COUNT, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


@pytest.fixture
def site(tmp_path):
    """Run the web application."""
    site = Site(tmp_path / "library")
    http = make_server("127.0.0.1", 0, site.app, threaded=True)
    thread = threading.Thread(target=http.serve_forever, args=(0.05,))
    thread.start()
    site.url = f"http://127.0.0.1:{http.port}"
    yield site
    http.shutdown()
    thread.join()
    http.server_close()
    site.library.database.close()


@pytest.fixture
def bag(tmp_path):
    """Record a robot driving a curve; each message is recorded just after its stamp, and one fix is late."""
    m = Messages(ros1=False)
    messages = []
    for number in range(COUNT):
        time_s = BEGIN_S + number / 4
        fix_s = time_s - 3.1 if number == 20 else time_s + 0.05
        pose = m.pose(number / 2, math.sin(number / 5) - number / 25, yaw=number / 30)
        fix = m.fix(fix_s, LAT + number * 1e-6, LON - number * 1e-6, status=-(number == 7), variance=2.0)
        messages += [
            ("/fix", time_s + 0.12, fix),
            ("/odom", time_s + 0.13, m.odometry(time_s, pose, variance=0.25 * (number % 3))),
            ("/tf", time_s + 0.14, m.transforms([(time_s + 0.01, "odom", "base_link", pose)])),
        ]
        if number % 5 == 0:  # two people who stand still, in varying order, with small errors
            off = number / 400
            seen = [
                ("", "person", 0.5, m.pose(4.0 + off, -3.0, 0.2)),
                ("", "person", 0.6, m.pose(9.0, 6.0 - off)),
            ]
            if number % 2:
                seen.reverse()
            messages.append(("/detections", time_s + 0.15, m.detections(time_s, seen, "odom")))
    beside = [("", "door", 0.7, m.pose(2.0, 1.0, 0.3)), ("exit", "door", 0.8, m.pose(2.0, -1.0))]
    end_s = BEGIN_S + COUNT / 4
    messages.append(("/detections", end_s, m.detections(end_s, beside, "base_link")))
    return m.bag(tmp_path / "bag", messages).parent


def poses_of(site, mission):
    """Return the tracks of a mission: from fixes, odometry and transforms."""
    with site.library.database.read() as session:
        found = tracks.list_tracks(session, mission)
        return {(t.source, t.name.endswith("tf")): tracks.read(session, t) for t in found}


def objects_of(site, mission):
    with site.library.database.read() as session:
        found = session.query(MissionObject).filter_by(mission_id=mission).order_by(MissionObject.object_id)
        return {row.object_id: row for row in found}


def test_a_bag_that_is_played_is_the_mission_that_an_import_makes_of_it(bench, site, bag, tmp_path):
    (tmp_path / "token").write_text(site.token)
    played, imported = site.new_mission(), site.new_mission()
    values = {"server_url": site.url, "token_file": str(tmp_path / "token"), "spool": str(tmp_path / "spool")}
    values |= {f"qos_overrides.{topic}.subscription.durability": "transient_local" for topic in KINDS}
    bench.start(MissionBridge, **values, mission=played, start=f"{LAT},{LON},120", tf="odom,base_link")
    publishers = {topic: bench.node.create_publisher(kind, topic, KEPT) for topic, kind in KINDS.items()}

    def publish(topics):
        with AnyReader([bag]) as reader:
            for connection, _, message in reader.messages():
                if connection.topic in topics:
                    publishers[connection.topic].publish(bytes(message))

    publish(MOVES)

    def counts():
        return Counter({key: len(poses) for key, poses in poses_of(site, played).items()})

    whole = {("gps", False): COUNT - 1, ("odometry", False): COUNT, ("odometry", True): COUNT}
    bench.until(lambda: counts() == whole)
    publish(["/detections"])
    bench.until(lambda: "exit" in objects_of(site, played))
    options = ReadOptions(start=Start(LatLon(LAT, LON), 120.0), min_move=MinMove(0.0), topics=tuple(KINDS))
    settings = Settings(library=tmp_path / "library")
    import_track_file(site.library, imported, order=Order(bag, "drive", options), settings=settings)
    sent, read = poses_of(site, played), poses_of(site, imported)
    assert sent.keys() == read.keys() == whole.keys()
    for key, poses in sent.items():
        assert poses.times_s.tolist() == read[key].times_s.tolist()
        for field in ("latlon", "height_m", "heading_deg", "covariance_m2", "travelled_m"):
            off = 1e-8 if field == "latlon" else 1e-3  # a millimetre in both cases
            ours, theirs = getattr(poses, field), getattr(read[key], field)
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=off, err_msg=f"{key} {field}")
    assert sent["gps", False].latlon.tolist() == read["gps", False].latlon.tolist()
    ours, theirs = objects_of(site, played), objects_of(site, imported)
    assert set(ours) == set(theirs) == {"person #1", "person #2", "door #1", "exit"}
    assert ours["person #1"].sightings == COUNT / 5
    for id, row in ours.items():
        for field in (
            "kind",
            "sightings",
            "first_time_s",
            "last_time_s",
            "confidence",
            "size_m",
            "associated",
        ):
            assert getattr(row, field) == getattr(theirs[id], field), (id, field)
        assert (row.lat, row.lon) == pytest.approx((theirs[id].lat, theirs[id].lon), abs=1e-8)
        assert row.height_m == pytest.approx(theirs[id].height_m, abs=1e-3)
        assert (row.covariance_m2 is None) == (theirs[id].covariance_m2 is None) == (not row.associated)
        assert row.covariance_m2 is None or row.covariance_m2 == pytest.approx(theirs[id].covariance_m2)
