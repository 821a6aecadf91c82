"""Depths of points seen by several oriented photos."""

from dataclasses import replace

import numpy as np
import pytest

from tests.core.photos_in_a_room import RADIUS, Scene, cameras, tilted
from webapp.core.geometry.extrinsics import KeypointDepths, MapExtrinsics, empty_depths
from webapp.core.reconstruction.depths import DepthsExcluding, triangulate_depths

NOISE = np.full(20, 1.0 / 450.0)
"""Noise of the keypoints of each photo, at depth 1."""


@pytest.fixture(scope="module")
def room():
    scene = Scene(seed=4)
    held = cameras(scene, 12, seed=5)
    return scene, held, scene.pairs(held)


def oriented(held, trust=5.0):
    rotation = np.array([r for r, _ in held])
    return MapExtrinsics(rotation, np.zeros(len(held)), np.full(len(held), trust), empty_depths())


def positions(held):
    return np.array([p for _, p in held])


def seen_in(room, pairs=None, extrinsics=None, at=None):
    _, held, known = room
    return triangulate_depths(
        pairs or known,
        positions(held) if at is None else at,
        extrinsics=extrinsics or oriented(held),
        ray_sigma=NOISE,
        place_radius_px=RADIUS,
    )


def found_in(room, **given):
    return seen_in(room, **given).fuse()


def truth_of(room, depths):
    scene, held, _ = room
    return np.array(
        [
            scene.inverse_depths(held[photo], [row])[0]
            for photo, row in zip(depths.photo, depths.row, strict=True)
        ]
    )


def test_depths_are_those_of_the_points(room):
    depths = found_in(room)
    off = depths.inverse_depth / truth_of(room, depths) - 1.0
    assert len(depths.row) > 500
    assert np.median(np.abs(off)) < 0.03


@pytest.mark.parametrize("misplaced", [0.0, 0.1])
def test_their_spread_is_about_how_far_they_are_off(room, misplaced):
    """With image noise alone it is too large, as it assumes position errors of a tenth of a radius."""
    _, held, _ = room
    shift = np.random.default_rng(1).normal(0.0, misplaced * RADIUS, (len(held), 2))
    depths = found_in(room, at=positions(held) + shift)
    ratio = np.abs(depths.inverse_depth - truth_of(room, depths)) / depths.sigma
    typical = np.quantile(ratio, 0.68)
    assert 0.02 < typical < 0.5 if misplaced == 0.0 else 0.5 < typical < 2.0


def test_a_photo_from_nearer_by_knows_a_depth_better():
    """Of two cameras, one far behind the other, the far one gains more: its points are seen from nearby."""
    scene = Scene(seed=3)
    held = [(tilted(0.0), np.array([10.0, 100.0])), (tilted(0.0), np.array([0.0, -90.0]))]
    pair = scene.pair((0, 1), held, noise=0.0)
    seen = triangulate_depths(
        pair, positions(held), extrinsics=oriented(held), ray_sigma=NOISE, place_radius_px=1e-3
    )
    relative = [np.median((seen.sigma / seen.inverse_depth)[seen.photo == n]) for n in (0, 1)]
    shaken = np.random.default_rng(0).normal(0.0, 1.0 / 450.0, (2, 40, *pair.ray_first.shape))
    off = [[], []]
    for ours, theirs in shaken.swapaxes(0, 1):
        noisy = replace(pair, ray_first=pair.ray_first + ours, ray_second=pair.ray_second + theirs)
        again = triangulate_depths(
            noisy, positions(held), extrinsics=oriented(held), ray_sigma=NOISE, place_radius_px=1e-3
        )
        for n in (0, 1):
            mine = np.flatnonzero(again.photo == n)
            truth = scene.inverse_depths(held[n], again.row[mine])
            off[n] += (np.abs(again.inverse_depth[mine] / truth - 1.0)).tolist()
    real = [np.quantile(o, 0.68) for o in off]
    assert relative[0] < 0.8 * relative[1]
    assert np.array(relative) == pytest.approx(real, rel=0.3)


def test_each_keypoint_has_one_depth_in_order(room):
    depths = found_in(room)
    keys = list(zip(depths.photo.tolist(), depths.row.tolist(), strict=True))
    assert keys == sorted(set(keys))


def test_wrong_matches_have_no_depth_or_an_uncertain_one(room):
    *_, pairs = room
    rng = np.random.default_rng(0)
    wrong = rng.random(len(pairs.row_first)) < 0.3
    shaken = pairs.ray_second.copy()
    shaken[wrong] = rng.uniform(-0.7, 0.7, (int(wrong.sum()), 2))
    depths = found_in(room, pairs=replace(pairs, ray_second=shaken))
    ratio = np.abs(depths.inverse_depth - truth_of(room, depths)) / depths.sigma
    assert (ratio < 3.0).mean() > 0.95


def test_photos_without_orientation_give_no_depths(room):
    _, held, _ = room
    known = oriented(held)
    depths = found_in(room, extrinsics=replace(known, trust=np.where(np.arange(12) == 3, 0.1, 5.0)))
    assert len(depths.row) and not (depths.photo == 3).any()
    assert not len(found_in(room, extrinsics=oriented(held, trust=0.0)).row)


def test_they_are_looked_up_by_photo_and_keypoint(room):
    depths = found_in(room)
    photo = int(depths.photo[200])
    there = depths.row[depths.photo == photo]
    absent = int(there.max()) + 1
    inverse, spread = depths.lookup(photo, np.array([there[1], absent, there[0]]))
    mine = np.flatnonzero(depths.photo == photo)
    assert inverse[[0, 2]].tolist() == depths.inverse_depth[mine[[1, 0]]].tolist()
    assert spread[[0, 2]].tolist() == depths.sigma[mine[[1, 0]]].tolist()
    assert np.isnan([inverse[1], spread[1]]).all()
    assert np.isnan(empty_depths().lookup(photo, there)).all()
    assert depths.lookup(photo, np.zeros(0, np.int64))[0].shape == (0,)


def test_photos_can_get_other_numbers():
    depths = KeypointDepths(
        *(np.array(v, np.int32) for v in ([0, 0, 2, 3], [4, 9, 1, 7])),
        *(np.array(v, np.float32) for v in ([0.1, 0.2, 0.3, 0.4], [1, 2, 3, 4])),
    )
    again = depths.renumbered(np.array([5, -1, -1, 1]))
    assert again.photo.tolist() == [1, 5, 5]
    assert again.row.tolist() == [7, 4, 9]
    assert again.sigma.tolist() == [4, 1, 2]


def test_what_both_photos_of_a_pair_see_counts_once(room):
    seen = seen_in(room)
    keys = set(zip(seen.photo.tolist(), seen.row.tolist(), seen.partner.tolist(), strict=True))
    assert len(keys) == len(seen.photo)
    _, _, pairs = room
    assert len(keys) < 2 * len(pairs.row_first)


def test_without_some_photos_depths_rest_on_no_sighting_of_them(room):
    _, held, pairs = room
    hidden = np.isin(np.arange(len(held)), [2, 5])
    left = np.flatnonzero(~(hidden[pairs.first] | hidden[pairs.second]))
    fewer = pairs.subset(left, first=pairs.first[left], second=pairs.second[left])
    never, seen, rows = found_in(room, pairs=fewer), seen_in(room), np.arange(4000)
    for photo in range(len(held)):
        inverse, spread = DepthsExcluding(seen, hidden).lookup(photo, rows)
        np.testing.assert_allclose(inverse, never.lookup(photo, rows)[0], rtol=1e-6)
        np.testing.assert_allclose(spread, never.lookup(photo, rows)[1], rtol=1e-6)
    assert 0 < len(never.row) < len(seen.fuse().row)
    everyone = DepthsExcluding(seen, np.ones(len(held), bool))
    assert np.isnan(everyone.lookup(0, rows)).all()
