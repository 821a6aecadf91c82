"""A bag with GPS and odometry proposes the start of its odometry."""

import pytest

from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.robotframe import RobotFrame, Start
from webapp.missions.tasks.inspect_file import as_json, inspect_file


def test_a_bag_with_fixes_and_odometry_proposes_its_start(ros, tmp_path):
    m, frame = ros(False), RobotFrame(Start(LatLon(50.1, 14.4), 70.0))
    messages = []
    for n in range(60):
        x, y = float(min(n, 30)), float(max(n - 30, 0))
        lat, lon = frame.latlon_from_xy([[x, y]])[0].tolist()
        at = 1.7e9 + n
        messages.append(("/fix", at, m.fix(at, lat, lon, variance=1.0)))
        messages.append(("/odom", at, m.odometry(at, m.pose(x + 7.0, y))))
    report = as_json(inspect_file(m.bag(tmp_path / "run", messages)))
    assert report["start"]["lat"] == pytest.approx(50.1, abs=2e-6)
    assert report["start"]["lon"] == pytest.approx(14.4, abs=2e-6)
    assert report["start"]["heading_deg"] == pytest.approx(70.0, abs=0.5)


def test_a_bag_with_odometry_alone_proposes_none(ros, tmp_path):
    m = ros(False)
    messages = [("/odom", 1.7e9 + n, m.odometry(1.7e9 + n, m.pose(float(n)))) for n in range(20)]
    assert inspect_file(m.bag(tmp_path / "run", messages)).start is None
