"""Metres around an origin agree with those of the program, which uses PROJ."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Odometry

from expmap_ros.geodesy import Origin
from expmap_ros.robot_frame import RobotFrame, pose_of
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory import robotframe


@pytest.mark.parametrize(("distance", "off"), [(1000.0, 0.001), (5000.0, 0.01)])
@pytest.mark.parametrize("lat", [-60.0, -33.0, 0.0, 50.0, 60.0])
def test_positions_are_as_right_as_the_module_says(lat, distance, off):
    origin, frame = Origin(lat, 179.999), LocalFrame(LatLon(lat, 179.999))
    for angle in np.linspace(0.0, math.tau, 16, endpoint=False):
        x, y = distance * math.cos(angle), distance * math.sin(angle)
        found = origin.degrees_of(x, y)
        east, north = frame.enu_from_latlon([found])[0]
        assert math.hypot(east - x, north - y) < off
        assert origin.metres_of(*found) == pytest.approx((x, y), abs=1e-6)


def test_odometry_is_where_an_import_of_it_is():
    start = (50.0755, 14.4378, 120.0)
    message = Odometry()
    message.pose.pose.position.x, message.pose.pose.position.y = 30.0, -12.0
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(0.2), math.cos(0.2)
    sent = RobotFrame(*start).fields(pose_of(message))
    imported = robotframe.RobotFrame(robotframe.Start(LatLon(*start[:2]), start[2]))
    lat, lon = imported.latlon_from_xy(np.array([[30.0, -12.0]]))[0]
    assert (sent["lat"], sent["lon"]) == pytest.approx((lat, lon), abs=1e-8)
    assert sent["heading_deg"] == pytest.approx(float(imported.heading_from_yaw(np.array([0.4]))[0]))
