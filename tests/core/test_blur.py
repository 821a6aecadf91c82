"""Parts of pictures are blurred beyond recognition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.blur import blur
from webapp.core.boxes import BlurBox

SHARE = st.floats(0, 1)


@pytest.fixture
def noise():
    return np.random.default_rng(3).integers(0, 256, (120, 160, 3), dtype=np.uint8)


def test_only_the_box_changes_and_nothing_of_it_is_left(noise):
    before = noise.copy()
    after = blur(noise, [BlurBox(0.25, 0.25, 0.5, 0.5)])
    inside = (slice(30, 90), slice(40, 120))
    changed = np.any(after != before, axis=2)
    assert changed[inside].mean() > 0.95
    changed[inside] = False
    assert not changed.any()
    assert np.array_equal(noise, before)
    assert after[inside].std() < 0.25 * before[inside].std()


def test_what_differs_in_detail_looks_the_same(noise):
    other = noise.copy()
    other[30:90, 40:120] = other[30:90, 40:120][:, ::-1][::-1]
    rows = np.repeat(np.arange(30, 90), 80), np.tile(np.arange(40, 120), 60)
    mean_before = np.abs(noise[rows].astype(int) - other[rows]).mean()
    box = [BlurBox(0.25, 0.25, 0.5, 0.5)]
    mean_after = np.abs(blur(noise, box)[rows].astype(int) - blur(other, box)[rows]).mean()
    assert mean_after < 0.15 * mean_before


@given(st.lists(st.builds(BlurBox, SHARE, SHARE, SHARE, SHARE), max_size=3))
def test_any_box_gives_a_picture(boxes):
    picture = np.full((7, 5, 3), 90, np.uint8)
    assert np.array_equal(blur(picture, boxes), picture)
