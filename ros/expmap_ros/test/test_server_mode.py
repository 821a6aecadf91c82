"""With a map on a server, the node needs only the robots' client."""

import re
import subprocess
import sys

import cv2
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Image, NavSatFix
from std_msgs.msg import Header

from expmap_ros.messages import POSES_IN_MAP
from expmap_ros.pictures import image_of
from expmap_ros.pose_estimator import PoseEstimator
from ros.expmap_ros.test.support import LAT, LON, ids_and_probabilities, textured
from tests.robot.stand_in import StandIn, refused

ANSWER = {
    "verdict": "place",
    "hypotheses": [
        {
            "x_px": 30.0, "y_px": 40.0, "radius_px": 10.0, "radius_m": 1.5, "heading_deg": 90.0,
            "lat": LAT + 1e-4, "lon": LON, "probability": 0.9, "experiences": [7, 8],
        }
    ],
    "off_map_probability": 0.1,
}  # fmt: skip


def test_a_server_is_asked_and_its_failures_are_told(bench, tmp_path):
    (tmp_path / "token").write_text("secret\n")
    with StandIn() as server:
        server.script = lambda path, body: (200, ANSWER, {})
        values = {"server_url": server.url, "token_file": str(tmp_path / "token"), "map_name": "park"}
        bench.start(PoseEstimator, **values, origin=f"{LAT},{LON}", fov_deg=60.0, top=3, sequence=True)
        camera = bench.node.create_publisher(Image, "/gscam/image_raw", 1)
        poses = bench.listen(PoseWithCovarianceStamped, "/pose_estimator/pose")
        fixes = bench.listen(NavSatFix, "/pose_estimator/fix")
        lists = bench.listen(POSES_IN_MAP, "/poses_in_map")
        states = bench.listen(DiagnosticArray, "/diagnostics")
        message = image_of(cv2.cvtColor(textured(1), cv2.COLOR_BGR2RGB), Header(frame_id="camera"))
        bench.until(lambda: poses and fixes and lists, lambda: camera.publish(message))
        at = poses[0].pose.pose
        assert abs(at.position.x) < 1e-6 and abs(at.position.y - 11.12) < 0.02
        assert (at.orientation.z, at.orientation.w) == (0.0, 1.0), "it looks east"
        assert ids_and_probabilities(lists[0]) == ([7], [pytest.approx(0.9)])
        path, body = server.requests[0]
        assert (path, body["token"]) == ("/api/v1/maps/park/localize", "Bearer secret")
        for part in (b'name="top"\r\n\r\n3', b'name="fov"\r\n\r\n60.0', b"\x89PNG"):
            assert part in body["form"]
        bench.until(lambda: len(server.requests) >= 2, lambda: camera.publish(message))
        names = [re.search(rb'name="sequence"\r\n\r\n(\w+)', b["form"])[1] for _, b in server.requests]
        assert len(set(names)) == 1 and len(names[0]) == 32
        server.script = lambda path, body: refused(503)

        def failed():
            return states and states[-1].status[0].level == DiagnosticStatus.ERROR

        bench.until(failed, lambda: camera.publish(message))
        assert "503" in states[-1].status[0].message


def test_it_needs_the_robots_client_alone():
    code = (
        "import sys, expmap_ros.pose_estimator, expmap_ros.client\n"
        "print(*sorted({'cv2', 'PIL', 'flask', 'faiss', 'sqlalchemy', 'webapp.api'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
