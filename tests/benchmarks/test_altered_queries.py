"""The alterations of queries are what they say."""

import numpy as np
import pytest

from benchmarks import altered_queries
from webapp.core.features.bars import Inside, inside_bars


@pytest.fixture
def photo():
    return np.random.default_rng(0).integers(0, 256, (90, 160, 3)).astype(np.uint8)


def test_bars_are_those_that_are_cut_off_again(photo):
    shot = altered_queries.with_bars(photo)
    height, width = shot.shape[:2]
    assert width == 160 and height == int(160 * 19.5 / 9.0)
    top = (height - 90) // 2
    assert inside_bars(shot[:, :, 0]) == Inside(0, top, 160, top + 90)


def test_crops_keep_the_middle_and_the_focal_length(photo):
    half = altered_queries.cropped(photo, 0.5)
    assert (half == photo[22:68, 40:120]).all()
    assert altered_queries._seen(90.0, 0.5) == pytest.approx(53.13, abs=0.01)


def test_each_alteration_gives_a_photo(photo):
    for alteration in altered_queries.ALTERATIONS.values():
        changed = alteration.change(photo)
        assert changed.dtype == np.uint8 and changed.ndim == 3
    assert altered_queries.ALTERATIONS["black"].change(photo).std() < 2
