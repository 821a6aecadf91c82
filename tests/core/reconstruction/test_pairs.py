"""Pairs of photos: of several comparisons the most trusted one counts."""

import numpy as np

from webapp.core.reconstruction.pairs import PhotoPairs, best_of_each_pair, concatenate


def pair(first, second, trust, rays):
    """Make a pair with so many matches, whose rays say how far it is trusted."""
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
