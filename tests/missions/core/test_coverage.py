"""The share of an area that tracks have covered, against areas known exactly."""

import tracemalloc

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


@pytest.mark.parametrize("seed", range(8))
def test_samples_within_the_radius_of_ways_are_covered_and_no_others(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-60, 160, (12, 2))
    points[3] = points[2]
    points[5, 1] = points[4, 1]
    points[7, 0] = points[6, 0]
    joined = rng.random(11) < 0.7
    joined[[2, 4, 6]] = True
    found = Coverage(SQUARE, 7.0)
    found.add(points, joined)
    at = np.linspace(0, 100, 301)
    at = (at[:-1] + at[1:]) / 2
    x, y = np.meshgrid(at, at)
    nearest = np.min([np.hypot(x - px, y - py) for px, py in points], axis=0)
    for begin, way, known in zip(points[:-1], np.diff(points, axis=0), joined, strict=True):
        if known and way.any():
            t = np.clip(((x - begin[0]) * way[0] + (y - begin[1]) * way[1]) / (way @ way), 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - begin[0] - t * way[0], y - begin[1] - t * way[1]))
    assert found.share == pytest.approx((nearest <= 7.0).mean(), abs=0.004)


def test_ways_around_the_earth_cost_what_ways_across_the_area_do():
    rng = np.random.default_rng(0)
    far = rng.uniform(-2e7, 2e7, (3000, 2))
    trail = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 50_000.0], [0.0, 50_000.0]])
    tracemalloc.start()
    found = Coverage(trail, 0.5)
    found.add(far, np.ones(2999, dtype=bool))
    found.add(np.array([[0.5, -2e7], [0.5, 2e7]] * 10), np.ones(19, dtype=bool))
    assert tracemalloc.get_traced_memory()[1] < 250e6
    tracemalloc.stop()
    assert found.share == 1.0
