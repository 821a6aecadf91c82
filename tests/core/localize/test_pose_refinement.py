import math
from dataclasses import replace

import numpy as np
import pytest

from tests.core.photos_in_a_room import RADIUS, RAY_SIGMA, Scene, cameras, tilted
from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MapExtrinsics, empty_depths
from webapp.core.localize.pose_refinement import (
    _score,
    collect_correspondences,
    depth_residual,
    epipolar_residual,
    estimate_poses,
)
from webapp.core.tuning import DEFAULT


def known(held, trust=5.0):
    count = len(held)
    return MapExtrinsics(
        np.array([r for r, _ in held]), np.zeros(count), np.full(count, trust), empty_depths()
    )


def positions(held):
    return np.array([position for _, position in held])


def correspondences(views, held, min_depth=0.0):
    """Return all matches of the views; photo n of the map is the n-th camera."""
    return collect_correspondences(
        views,
        [*range(len(views))],
        world=known(held).centres(positions(held)),
        extrinsics=known(held),
        radius=RADIUS,
        min_depth=min_depth,
    )


@pytest.mark.parametrize("heading_deg", [10.0, 130.0, 300.0])
def test_a_query_is_located_with_its_heading(heading_deg):
    scene = Scene()
    held = cameras(scene, 40)
    query = (tilted(math.radians(heading_deg), 0.1), np.array([12.0, -20.0]))
    views = [v for n, c in enumerate(held) if len((v := scene.view(n, c, query)).query_ray) >= 20]
    best = estimate_poses(views, positions(held), extrinsics=known(held), place_radius_px=RADIUS)[0]
    assert math.dist((best.x, best.y), query[1]) < 0.06 * RADIUS
    assert abs(math.remainder(best.heading - math.radians(heading_deg), 2 * math.pi)) < math.radians(1.5)
    assert best.score > 1.0
    assert (np.linalg.eigvalsh(best.covariance_px2) > 0.0).all()


def test_wrong_matches_change_little():
    scene = Scene(seed=2)
    held = cameras(scene, 40, seed=3)
    query = (tilted(2.0), np.array([5.0, 8.0]))
    views = [v for n, c in enumerate(held) if len((v := scene.view(n, c, query)).query_ray) >= 20]
    rng = np.random.default_rng(0)
    for view in views:
        wrong = rng.random(len(view.query_ray)) < 0.4
        view.photo_ray[wrong, :2] = rng.uniform(-0.7, 0.7, (int(wrong.sum()), 2))
    best = estimate_poses(views, positions(held), extrinsics=known(held), place_radius_px=RADIUS)[0]
    assert math.dist((best.x, best.y), query[1]) < 0.15 * RADIUS


def test_without_known_orientations_there_is_no_pose():
    scene = Scene()
    held = cameras(scene, 10)
    query = (tilted(1.0), np.array([5.0, 8.0]))
    views = [scene.view(n, c, query) for n, c in enumerate(held)]
    views = [v for v in views if len(v.query_ray) >= 20]
    assert (
        estimate_poses(views, positions(held), extrinsics=known(held, trust=0.1), place_radius_px=RADIUS)
        == []
    )
    assert estimate_poses([], positions(held), extrinsics=known(held), place_radius_px=RADIUS) == []


def test_one_photo_is_enough_where_depths_are_known():
    scene = Scene(seed=6)
    held = [(tilted(0.3), np.array([0.0, 0.0]))]
    query = (tilted(0.5, 0.05), np.array([25.0, -30.0]))
    fixed, open_ = (
        estimate_poses(
            [scene.view(0, held[0], query, depths=depths)],
            positions(held),
            extrinsics=known(held),
            place_radius_px=RADIUS,
        )[0]
        for depths in (True, False)
    )
    assert math.dist((fixed.x, fixed.y), query[1]) < 0.1 * RADIUS
    assert np.trace(open_.covariance_px2) > 100.0 * np.trace(fixed.covariance_px2)


def test_depths_make_positions_surer_and_better():
    scene = Scene(seed=7)
    held = [(tilted(0.8 * n), np.array([3.0 * n, 2.0 * n])) for n in range(8)]
    off, sure = [], []
    for n in range(8):
        query = (tilted(0.8 * n), np.array([40.0 * math.sin(n), 40.0 * math.cos(n)]))
        for depths in (False, True):
            views = [scene.view(k, c, query, noise=0.003, depths=depths) for k, c in enumerate(held)]
            views = [v for v in views if len(v.query_ray) >= 20]
            best = estimate_poses(views, positions(held), extrinsics=known(held), place_radius_px=RADIUS)[0]
            off.append(math.dist((best.x, best.y), query[1]))
            sure.append(np.trace(best.covariance_px2))
    assert np.median(off[1::2]) < 0.8 * np.median(off[::2])
    assert (np.array(sure[1::2]) < np.array(sure[::2])).all()


def test_wrong_depths_do_not_drag_a_position_away():
    scene = Scene(seed=9)
    held = cameras(scene, 30, seed=10)
    query = (tilted(2.2), np.array([-10.0, 15.0]))
    views = [scene.view(n, c, query, depths=True) for n, c in enumerate(held)]
    views = [v for v in views if len(v.query_ray) >= 20]
    rng = np.random.default_rng(1)
    for view in views:
        wrong = rng.random(len(view.inverse_depth)) < 0.3
        view.inverse_depth[wrong] *= rng.uniform(1.5, 4.0, int(wrong.sum()))
    best = estimate_poses(views, positions(held), extrinsics=known(held), place_radius_px=RADIUS)[0]
    assert math.dist((best.x, best.y), query[1]) < 0.1 * RADIUS


def test_derivatives_are_those_of_the_residuals():
    scene = Scene(seed=11)
    held = cameras(scene, 6, seed=12)
    query = (tilted(0.7, 0.1), np.array([8.0, 4.0]))
    views = [v for n, c in enumerate(held) if len((v := scene.view(n, c, query, depths=True)).query_ray) > 20]
    matches = correspondences(views, held)
    rotation, centre = query[0][None], np.array([[8.0, 0.0, -4.0]])
    small = 1e-6
    for compare in (epipolar_residual, depth_residual):
        found = compare(matches, rotation=rotation, centre=centre)
        result = found.derivatives(RADIUS)[0]
        for axis in range(6):
            step = np.eye(6)[axis] * small
            turned, shifted = so3.retract(rotation, step[None, :3]), centre + RADIUS * step[3:]
            moved = compare(matches, rotation=turned, centre=shifted)
            real = (moved.value - found.value)[0] / small
            # the denominator and the direction of the epipolar line change slightly, too
            assert np.median(np.abs(real - result[axis])) < 0.02 * np.abs(result).max()


@pytest.mark.parametrize("baseline", [0.0, 1e-9, 1e-3])
@pytest.mark.parametrize("depths", [False, True])
def test_matches_disagree_with_a_wrong_rotation_at_zero_baseline(baseline, depths):
    """Without a minimum depth, any rotation could be explained by the parallax of very close points."""
    scene = Scene(seed=13)
    held = [(tilted(0.3), np.array([0.0, 0.0]))]
    views = [scene.view(0, held[0], (tilted(0.3), np.array([25.0, -30.0])), depths=depths)]
    matches = correspondences(views, held, min_depth=DEFAULT.pose.min_depth * RADIUS)
    aside = held[0][0].T @ np.array([1.0, 0.0, 0.0])
    score, agreement = _score(
        matches,
        tilted(0.3 + math.radians(10.0))[None],
        (-baseline * aside)[None],
        inlier_sigmas=DEFAULT.pose.inlier_sigmas,
        tuning=DEFAULT.pose,
    )
    assert agreement.max() < 0.2
    assert score[0] < 0.2


def test_matches_agree_with_the_right_rotation_at_the_photo_itself():
    scene = Scene(seed=13)
    held = [(tilted(0.3), np.array([0.0, 0.0]))]
    near = (tilted(0.35), np.array([0.01, 0.0]))
    matches = correspondences([scene.view(0, held[0], near)], held, min_depth=DEFAULT.pose.min_depth * RADIUS)
    _, agreement = _score(matches, near[0][None], np.zeros((1, 3)), inlier_sigmas=1.25, tuning=DEFAULT.pose)
    assert agreement.max() > 0.9


def test_the_noise_of_a_residual_is_that_of_its_keypoints():
    """A quarter of the field of view means four times the focal length and a quarter of the noise."""
    scene = Scene(seed=14)
    held = cameras(scene, 3, seed=15)
    query = (tilted(0.7), np.array([8.0, 4.0]))
    views = [scene.view(n, c, query, depths=True) for n, c in enumerate(held)]
    sharp = [replace(v, ray_sigma=(RAY_SIGMA / 4.0, RAY_SIGMA / 4.0)) for v in views]
    pose = {"rotation": query[0][None], "centre": np.array([[8.0, 0.0, -4.0]])}
    one, other = (epipolar_residual(correspondences(v, held), **pose) for v in (views, sharp))
    assert np.allclose(one.value, other.value)
    assert np.allclose(one.sigma, RAY_SIGMA)
    assert np.allclose(other.sigma, RAY_SIGMA / 4.0)
    one, other = (depth_residual(correspondences(v, held), **pose) for v in (views, sharp))
    assert (other.sigma < one.sigma).all()
