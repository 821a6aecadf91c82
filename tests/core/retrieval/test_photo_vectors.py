"""One vector per photo: another view of a photo is more similar than anything else."""

import numpy as np
import pytest

from tests.core.retrieval.test_signatures import scenes, seen_again
from webapp.core.retrieval import global_descriptors


def test_a_photo_that_is_seen_again_is_the_most_alike():
    photos = scenes(200, seed=1)
    basis = global_descriptors.train_basis(photos[:150])
    vectors = np.array([global_descriptors.photo_vector(basis, p) for p in photos])
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(np.ones(200), abs=1e-5)
    for number in (0, 77, 149, 199):  # the last was not trained on
        again = global_descriptors.photo_vector(basis, seen_again(photos[number], seed=number))
        assert int(np.argmax(vectors @ again)) == number


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_photos_give_few_axes(count):
    basis = global_descriptors.train_basis(scenes(count, seed=3))
    lengths = np.linalg.norm(basis.axes, axis=0)
    assert int((lengths > 0.5).sum()) == count - 1
    assert lengths[lengths > 0.5] == pytest.approx(np.ones(count - 1), abs=1e-3)


def test_without_descriptors_a_photo_is_like_none():
    photos = scenes(5, seed=4)
    basis = global_descriptors.train_basis(photos)
    assert not global_descriptors.photo_vector(basis, photos[0][:0]).any()
