"""Landmarks that agree on a camera are evidence, however many photos share them; clusters are not."""

import numpy as np
import pytest

from webapp.core.localize.landmarks import agreeing_photos

LONGER_PX = 800.0


def worth(xy, inliers):
    return agreeing_photos(xy.astype(np.float32), np.arange(len(xy)) < inliers, longer_px=LONGER_PX)


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.fixture
def spread(rng):
    return rng.uniform(0, 600, (120, 2))


def test_many_landmarks_all_over_the_picture_are_worth_more_than_one_photo(spread):
    assert worth(spread, 100) > 1.0
    assert worth(spread, 100) > worth(spread, 60) > 0.0


def test_landmarks_close_together_are_worth_nothing(rng):
    assert worth(rng.uniform(100, 150, (120, 2)), 100) == 0.0


def test_few_of_many_matches_agree_by_chance(spread):
    assert worth(spread, 16) == 0.0
    assert worth(spread, 0) == 0.0
