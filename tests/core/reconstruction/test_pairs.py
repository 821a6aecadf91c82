"""Pairs of photos: of several comparisons, the most trusted one is used."""

from types import SimpleNamespace

import numpy as np

from webapp.core.geometry.relative_pose import Camera
from webapp.core.reconstruction.pairs import (
    PhotoPairs,
    _pair,
    best_of_each_pair,
    concatenate,
    strongest_partners,
)
from webapp.core.retrieval.retrieve import ShortlistedPhoto


def pair(first, second, trust, rays):
    """Make a pair with a number of matches, whose rays encode the trust."""
    ray = np.full((rays, 2), trust, np.float32)
    return PhotoPairs(
        first=np.array([first]),
        second=np.array([second]),
        rotation=np.eye(3)[None],
        translation=np.array([[0.0, 0.0, 1.0]]),
        trust=np.array([trust]),
        parallax=np.array([0.1]),
        start=np.array([0, rays]),
        row_first=np.arange(rays, dtype=np.int32),
        row_second=np.arange(rays, dtype=np.int32),
        ray_first=ray,
        ray_second=ray,
    )


def test_of_the_same_photos_the_most_trusted_comparison_is_kept():
    both = best_of_each_pair(
        concatenate(
            [
                pair(3, 4, 0.2, 5),
                pair(1, 2, 0.9, 3),
                pair(4, 3, 0.1, 2),
                pair(3, 4, 0.6, 4),
                pair(1, 2, 0.5, 6),
            ]
        )
    )
    assert list(zip(both.first.tolist(), both.second.tolist(), both.trust.tolist(), strict=True)) == [
        (1, 2, 0.9),
        (4, 3, 0.1),
        (3, 4, 0.6),
    ]
    assert np.diff(both.start).tolist() == [3, 2, 4]
    assert np.allclose(both.ray_first[:, 0], np.repeat(both.trust, [3, 2, 4]))


def test_no_pairs_stay_none():
    assert len(best_of_each_pair(concatenate([]))) == 0


def test_thinned_matches_are_spread_evenly_over_the_inliers():
    pairs = concatenate([pair(1, 2, 0.9, 41), pair(3, 4, 0.8, 7), pair(5, 6, 0.7, 100)])
    few = pairs.thinned(40)
    assert np.diff(few.start).tolist() == [40, 7, 40]
    for first, stop in zip(few.start[:-1], few.start[1:], strict=True):
        rows = few.row_first[first:stop]
        assert (np.diff(rows) >= 1).all()
        assert np.ptp(np.diff(rows)) <= 1
    assert len(concatenate([]).thinned(40)) == 0


def test_a_pair_keeps_all_its_inliers():
    rng = np.random.default_rng(0)
    camera = Camera(800, 600, 70.0)
    points = rng.uniform((-4.0, -3.0, 5.0), (4.0, 3.0, 12.0), (150, 3))
    ours, theirs = (_project(camera, points - at) for at in (np.zeros(3), np.array([1.0, 0.0, 0.3])))
    rows = np.arange(len(points))
    matched = ShortlistedPhoto(1, 5.0, rows, rows, ours, theirs)
    found = _pair(SimpleNamespace(camera=lambda photo: camera), 0, matched=matched, ours=camera)
    assert np.diff(found.start)[0] >= 0.95 * len(points)


def _project(camera, points):
    centre = [(camera.width - 1) / 2.0, (camera.height - 1) / 2.0]
    return (camera.focal_px * points[:, :2] / points[:, 2:] + centre).astype(np.float32)


def test_the_strongest_partner_shares_most_inliers_and_enough():
    pairs = concatenate([pair(0, 1, 0.9, 50), pair(1, 2, 0.9, 80), pair(3, 0, 0.9, 60), pair(4, 5, 0.9, 39)])
    assert strongest_partners(pairs, photos=6, inliers=40).tolist() == [3, 2, 1, 0, -1, -1]
    assert strongest_partners(concatenate([]), photos=2, inliers=40).tolist() == [-1, -1]
