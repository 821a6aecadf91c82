import math

import numpy as np

from tests.core.photos_in_a_room import RADIUS, Scene, cameras
from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST
from webapp.core.reconstruction.orientation import estimate_extrinsics
from webapp.core.reconstruction.pairs import concatenate

NOISE = np.full(20, 1.0 / 450.0)
"""Noise of the keypoints of each photo, at depth 1."""


def errors_deg(found, held):
    truth = np.array([rotation for rotation, _ in held])
    return np.degrees(np.linalg.norm(so3.log(found.rotation @ np.swapaxes(truth, 1, 2)), axis=1))


def positions(held):
    return np.array([position for _, position in held])


def test_orientations_follow_from_relative_poses_and_positions():
    scene = Scene()
    held = cameras(scene, 14)
    found = estimate_extrinsics(scene.pairs(held), positions(held), ray_sigma=NOISE, place_radius_px=RADIUS)
    off = errors_deg(found, held)
    known = found.trust >= MIN_TRUST
    assert known.sum() >= 12
    assert np.median(off[known]) < 1.0
    assert off[known].max() < 6.0
    assert np.abs(found.height[known]).max() < 0.2 * RADIUS


def test_wrong_pairs_are_outvoted():
    scene = Scene(seed=3)
    held = cameras(scene, 14, seed=4)
    pairs = scene.pairs(held)
    wrong = np.arange(len(pairs)) % 4 == 0
    turn = so3.exp(np.random.default_rng(5).normal(0, 1.0, (int(wrong.sum()), 3)))
    pairs.rotation[wrong] = turn @ pairs.rotation[wrong]
    pairs.translation[wrong] = np.einsum("kij,kj->ki", turn, pairs.translation[wrong])
    found = estimate_extrinsics(pairs, positions(held), ray_sigma=NOISE, place_radius_px=RADIUS)
    known = found.trust >= MIN_TRUST
    assert np.median(errors_deg(found, held)[known]) < 1.5


def test_a_photo_without_partners_is_not_trusted():
    scene = Scene()
    held = cameras(scene, 6)
    alone = [*held, (so3.from_heading(np.array(1.0)), np.array([900.0, 900.0]))]
    found = estimate_extrinsics(scene.pairs(held), positions(alone), ray_sigma=NOISE, place_radius_px=RADIUS)
    assert found.trust[-1] == 0.0
    assert np.isfinite(found.rotation).all()


def test_a_map_without_pairs_knows_nothing():
    found = estimate_extrinsics(concatenate([]), np.zeros((3, 2)), ray_sigma=NOISE, place_radius_px=RADIUS)
    assert found.trust.tolist() == [0.0, 0.0, 0.0]


def test_photos_of_one_spot_say_nothing_about_each_other():
    scene = Scene()
    held = cameras(scene, 2)
    pair = scene.pair((0, 1), [held[0], (held[0][0], held[0][1] + 5.0)])
    found = estimate_extrinsics(pair, np.zeros((2, 2)), ray_sigma=NOISE, place_radius_px=RADIUS)
    assert found.trust.tolist() == [0.0, 0.0]


def test_pairs_can_be_taken_out_and_renumbered():
    scene = Scene()
    held = cameras(scene, 5)
    pairs = scene.pairs(held)
    which = np.array([2, 0])
    some = pairs.subset(which, first=np.array([7, 8]), second=np.array([9, 10]))
    lengths = np.diff(pairs.start)
    assert np.diff(some.start).tolist() == lengths[which].tolist()
    np.testing.assert_array_equal(
        some.ray_first[: lengths[2]], pairs.ray_first[pairs.start[2] : pairs.start[3]]
    )
    np.testing.assert_array_equal(some.ray_second[lengths[2] :], pairs.ray_second[: lengths[0]])
    assert some.first.tolist() == [7, 8]
    assert math.isclose(float(some.trust[1]), float(pairs.trust[0]))
