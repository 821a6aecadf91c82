import math

import numpy as np
import pytest

from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import MIN_MATCHES, Camera, relative_pose

CAMERA = Camera(640, 480, 65.0)


def project(points, position, heading_deg, camera=CAMERA):
    """Project points (east, north, up) into a level camera; (n, 2) pixels."""
    heading = math.radians(heading_deg)
    right = np.array([math.cos(heading), -math.sin(heading), 0.0])
    forward = np.array([math.sin(heading), math.cos(heading), 0.0])
    rel = points - position
    x, y, z = rel @ right, -rel[:, 2], rel @ forward
    centre = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    return (np.column_stack([x, y]) / z[:, None] * camera.focal_px + centre).astype(np.float32)


def scene(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-12, 12, count), rng.uniform(14, 40, count), rng.uniform(-4, 8, count)]
    )


@pytest.mark.parametrize(
    ("place", "bearing_deg"),
    [((3.0, 0.0), 90.0), ((-3.0, 0.0), -90.0), ((2.0, 2.0), 45.0), ((0.5, 4.0), 7.1)],
)
def test_bearing_of_a_photo_is_found_among_outliers(place, bearing_deg):
    points, rng = scene(120), np.random.default_rng(1)
    query_xy = project(points, np.array([0.0, 0.0, 0.0]), 0.0)
    photo_xy = project(points, np.array([*place, 0.0]), 10.0)
    photo_xy[:40] = rng.uniform(0, 480, (40, 2))
    pose = relative_pose(query_xy, photo_xy, query=CAMERA, photo=CAMERA)
    assert pose
    assert math.degrees(pose.bearing) == pytest.approx(bearing_deg, abs=3.0)
    assert pose.inlier[40:].mean() > 0.95
    assert pose.inlier[:40].mean() < 0.2


def test_photos_of_another_size_and_lens_fit_too():
    points, other = scene(80), Camera(1600, 1200, 80.0)
    pose = relative_pose(
        project(points, np.zeros(3), 0.0),
        project(points, np.array([3.0, 0.0, 0.0]), 0.0, other),
        query=CAMERA,
        photo=other,
    )
    assert math.degrees(pose.bearing) == pytest.approx(90.0, abs=3.0)


def test_parallax_distinguishes_near_from_far():
    points = scene(80)
    at_home = project(points, np.zeros(3), 0.0)
    near, far = (
        relative_pose(at_home, project(points, np.array([d, 0.0, 0.0]), 5.0), query=CAMERA, photo=CAMERA)
        for d in (0.2, 4.0)
    )
    assert near.parallax < math.radians(1.0) < far.parallax


def test_too_few_and_random_matches_are_no_pose():
    few = np.zeros((MIN_MATCHES - 1, 2), np.float32)
    assert not relative_pose(few, few, query=CAMERA, photo=CAMERA)
    rng = np.random.default_rng(3)
    a, b = (rng.uniform(0, 480, (20, 2)).astype(np.float32) for _ in range(2))
    pose = relative_pose(a, b, query=CAMERA, photo=CAMERA)
    assert isinstance(pose, NoPose) or pose.inlier.sum() < 14
    same = np.full((30, 2), 100.0, np.float32)
    relative_pose(same, same, query=CAMERA, photo=CAMERA)  # degenerate: any result, but no exception


def test_the_noise_of_rays_follows_from_focal_length_and_extraction_size():
    wide, narrow = Camera(1600, 1200, 90.0), Camera(1600, 1200, 30.0)
    assert wide.ray_sigma(2.0, extract_side_px=800) == pytest.approx(2.0 / 400.0)
    assert narrow.ray_sigma(2.0, extract_side_px=800) == pytest.approx(0.268 * 2.0 / 400.0, rel=1e-3)
    assert wide.ray_sigma(2.0, extract_side_px=1600) == pytest.approx(1.0 / 400.0)
    assert wide.ray_sigma(2.0, extract_side_px=5000) == pytest.approx(1.0 / 400.0)  # never scaled up
