"""Masks of panoramas as boxes."""

import tracemalloc

import numpy as np
import pytest

from webapp.core.mapmodel.panorama import boxes_of_mask


@pytest.mark.parametrize("shape", [(90, 180), (181, 362), (700, 1399)])
def test_boxes_cover_every_degree_of_which_a_part_is_masked(shape):
    used = np.random.default_rng(2).random(shape) > 0.001
    rows, columns = min(180, shape[0]), min(360, shape[1])
    wanted = np.zeros((rows, columns), np.bool_)
    y, x = np.nonzero(~used)
    wanted[y * rows // shape[0], x * columns // shape[1]] = True
    found = np.zeros_like(wanted)
    for box in boxes_of_mask(used):
        left, right = round(box.x * columns), round((box.x + box.width) * columns)
        found[round(box.y * rows) : round((box.y + box.height) * rows), left:right] = True
    np.testing.assert_array_equal(found, wanted)


def test_a_mask_takes_no_more_memory_than_its_pixels():
    used = np.zeros((1500, 3000), np.bool_)
    tracemalloc.start()
    try:
        assert boxes_of_mask(used) == ((0.0, 0.0, 1.0, 1.0),)
        assert tracemalloc.get_traced_memory()[1] < used.nbytes
    finally:
        tracemalloc.stop()
