"""Camera poses computed from points, with ground truth."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.landmarks.absolute_pose import (
    Lens,
    absolute_pose,
    angle_jacobian,
    euler_angles,
    match_points,
    project,
)

LENS = Lens(800, 600, 700.0, 0.05)
CENTRE, ROTATION = np.array([1.0, -2.0, 0.5]), so3.exp(np.array([0.2, -0.4, 0.1]))


def scene(rng, *, points=120, noise=0.0):
    own = np.column_stack([rng.uniform(-6, 6, (points, 2)), rng.uniform(10, 30, points)])
    at = own @ ROTATION + CENTRE
    xy = project(at, lens=LENS, rotation=ROTATION, centre=CENTRE)
    return xy + rng.normal(0.0, noise, xy.shape), at


def test_points_are_projected_as_colmap_does(rng):
    colmap = pytest.importorskip("pycolmap")
    _, at = scene(rng)
    own = (at - CENTRE) @ ROTATION.T
    camera = colmap.Camera(model="SIMPLE_RADIAL", width=800, height=600, params=[700.0, 400.0, 300.0, 0.05])
    # the origin of COLMAP's pixels is the outer corner of the first one, ours its centre
    expected = camera.img_from_cam(own) - 0.5
    np.testing.assert_allclose(project(at, lens=LENS, rotation=ROTATION, centre=CENTRE), expected, atol=1e-9)


def test_a_camera_is_found_among_wrong_matches(rng):
    xy, at = scene(rng)
    xy[::2] = rng.uniform(0.0, 600.0, (60, 2))
    pose = absolute_pose(xy, at, lens=LENS)
    np.testing.assert_allclose(pose.centre, CENTRE, atol=1e-4)
    np.testing.assert_allclose(pose.rotation, ROTATION, atol=1e-5)
    assert pose.inlier[1::2].all()
    assert pose.inlier[::2].mean() < 0.1


def test_the_covariance_is_the_scatter_of_the_answers(rng):
    found = [absolute_pose(*scene(rng, noise=0.6), lens=LENS) for _ in range(60)]
    stated = np.mean([np.sqrt(np.diag(pose.covariance)) for pose in found], 0)
    off = [[*(pose.centre - CENTRE), *so3.log(pose.rotation @ ROTATION.T)] for pose in found]
    np.testing.assert_allclose(np.std(off, 0), stated, rtol=0.35)


@pytest.mark.parametrize(("factor", "sigma"), [(1.06, 0.03), (0.87, 0.15), (1.3, 0.15)])
def test_a_wrong_focal_length_is_corrected_where_the_points_determine_it(rng, factor, sigma):
    xy, at = scene(rng, noise=0.5)
    xy[::4] = rng.uniform(0.0, 600.0, (30, 2))
    stated = replace(LENS, focal_px=factor * LENS.focal_px)
    given = absolute_pose(xy, at, lens=stated)
    refined = absolute_pose(xy, at, lens=replace(stated, focal_sigma=sigma))
    off = [np.linalg.norm(pose.centre - CENTRE) for pose in (refined, given)]
    assert off[0] < 0.05
    assert off[1] > 10.0 * off[0]
    assert refined.lens.focal_px == pytest.approx(LENS.focal_px, rel=0.02)
    assert refined.inlier.sum() > given.inlier.sum()


def test_what_a_distant_plane_leaves_open_of_the_focal_length_is_in_the_covariance(rng):
    """Focal length and distance of a plane across the line of sight cannot be separated."""
    own = np.column_stack([rng.uniform(-8, 8, (100, 2)), np.full(100, 20.0)])
    at = own @ ROTATION + CENTRE
    distances = []
    for _ in range(40):
        xy = project(at, lens=LENS, rotation=ROTATION, centre=CENTRE) + rng.normal(0.0, 0.5, (100, 2))
        lens = replace(LENS, focal_px=LENS.focal_px * np.exp(rng.normal(0.0, 0.1)), focal_sigma=0.1)
        pose = absolute_pose(xy, at, lens=lens)
        off = pose.centre - CENTRE
        distances.append(off @ np.linalg.solve(pose.covariance[:3, :3], off) / 3.0)
        assert np.sqrt(np.trace(pose.covariance[:3, :3])) > 0.5
    assert 0.5 < np.median(distances) < 1.3


def test_few_or_contradicting_points_give_no_camera(rng):
    xy, at = scene(rng)
    few = absolute_pose(xy[:11], at[:11], lens=LENS)
    wrong = absolute_pose(rng.uniform(0.0, 600.0, xy.shape), at, lens=LENS)
    assert [isinstance(one, NoPose) for one in (few, wrong)] == [True, True]
    assert few.reason == "11 landmarks, 12 needed"


def test_points_at_one_spot_leave_the_camera_open(rng):
    at = np.tile(CENTRE + ROTATION.T @ [0.0, 0.0, 10.0], (30, 1))
    xy = project(at, lens=LENS, rotation=ROTATION, centre=CENTRE)
    assert isinstance(absolute_pose(xy, at, lens=LENS), NoPose)


def test_a_descriptor_is_matched_to_the_point_that_it_clearly_shows(rng):
    look = rng.integers(0, 255, (4, 128), dtype=np.uint8)
    observations = np.vstack([look[0], look[0] ^ 1, look[1], look[2] ^ 16, look[2] ^ 17])
    point = np.array([0, 0, 1, 2, 3], np.int32)  # the last two have nearly equal descriptors
    query = np.vstack([look[0], look[2], look[1], look[0] ^ 3])
    row, seen = match_points(query, observations, point=point)
    assert row.tolist() == [0, 2]
    assert seen.tolist() == [0, 2]


@pytest.mark.parametrize("rows", [0, 1])
def test_nothing_is_matched_with_too_little(rows):
    one = np.zeros((rows, 128), np.uint8)
    row, seen = match_points(np.zeros((3, 128), np.uint8), one, point=np.zeros(rows, np.int32))
    assert len(row) == len(seen) == 0


@pytest.mark.parametrize(
    ("heading", "pitch", "roll"),
    [(0, 0, 0), (90, 0, 0), (-120, 20, 0), (30, -10, 15)],
)
def test_angles_are_those_of_the_camera(heading, pitch, roll):
    heading, pitch, roll = np.radians([heading, pitch, roll])
    forward = [np.sin(heading) * np.cos(pitch), -np.cos(heading) * np.cos(pitch), -np.sin(pitch)]
    right = np.array([np.cos(heading), np.sin(heading), 0.0])
    down = np.cross(forward, right)
    rotation = np.array(
        [np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward]
    )
    np.testing.assert_allclose(euler_angles(rotation), [heading, pitch, roll], atol=1e-12)
    small = np.array([1e-5, -2e-5, 3e-5])
    after = euler_angles(so3.exp(small) @ rotation)
    np.testing.assert_allclose(after - euler_angles(rotation), angle_jacobian(rotation) @ small, atol=1e-9)


def test_a_camera_that_looks_straight_down_heads_where_the_top_of_its_photo_is():
    heading, noise = np.radians(50.0), np.array([0.02, -0.03, 0.0])
    right, top = [np.cos(heading), np.sin(heading), 0.0], [np.sin(heading), -np.cos(heading), 0.0]
    rotation = so3.exp(noise) @ np.array([right, np.negative(top), [0.0, 0.0, 1.0]])
    found = np.degrees(euler_angles(rotation))
    np.testing.assert_allclose(found, [50.0, -90.0, 0.0], atol=2.5)
