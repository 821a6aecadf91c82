"""The share of an area that tracks have covered, against areas known exactly."""

import numpy as np
import pytest

from webapp.missions.core.coverage import Coverage, joined_by_time

SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])


def share(outline, points, *, radius_m=5.0, joined=True):
    found = Coverage(outline, radius_m)
    metres = np.array(points, dtype=float)
    found.add(metres, np.full(len(metres) - 1, joined))
    return found.share


@pytest.mark.parametrize("turn", [0.0, 0.3, 0.785, 2.0])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_a_straight_way_covers_a_strip_in_any_direction(turn, offset):
    along = np.array([np.cos(turn), np.sin(turn)])
    turned = (SQUARE - 50) @ np.array([along, [-along[1], along[0]]])
    ends = [along * -200 + offset, along * 200 + offset]
    assert share(turned, ends) == pytest.approx(0.1, abs=0.003)


def test_a_pose_covers_a_disc_and_ends_are_not_joined():
    assert share(SQUARE, [[50, 50]]) == pytest.approx(np.pi * 25 / 10_000, rel=0.05)
    assert share(SQUARE, [[20, 50], [80, 50]], joined=False) == pytest.approx(np.pi * 50 / 10_000, rel=0.05)


def test_a_concave_area_is_measured_inside_only():
    outline = np.array([[0, 0], [100, 0], [100, 100], [50, 10], [0, 100]], dtype=float)
    assert share(outline, [[50, 60], [50, 90]], radius_m=10) == 0.0
    assert share(outline, [[-50, 50], [150, 50]], radius_m=200) == 1.0


def test_an_area_far_smaller_than_the_radius():
    assert share(SQUARE / 100, [[150.5, 0.5]], radius_m=150) == pytest.approx(0.5, abs=0.05)


def test_a_way_is_known_where_poses_follow_each_other():
    times = np.array([0.0, 1, 2, 3, 20, 21, 20.5, 21.5])
    assert joined_by_time(times).tolist() == [True, True, True, False, True, False, True]
    assert joined_by_time(np.arange(5) * 60.0).all()
