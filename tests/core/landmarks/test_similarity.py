import numpy as np
import pytest

from tests.core.landmarks.scene import random_rotation
from webapp.core.landmarks.submodels import NoSimilarity, fit_similarity


@pytest.mark.parametrize("weighted", [False, True])
def test_a_similarity_is_found_exactly(rng, weighted):
    source, turn, shift = rng.normal(size=(12, 3)), random_rotation(rng), rng.normal(size=3)
    target = 2.7 * source @ turn.T + shift
    fit = fit_similarity(source, target, weight=rng.uniform(0.1, 9.0, 12) if weighted else None)
    assert abs(fit.scale - 2.7) < 1e-9
    assert np.abs(fit.rotation - turn).max() < 1e-9
    assert np.abs(fit.apply(source) - target).max() < 1e-9


def test_three_points_are_enough_in_space_and_two_in_the_plane(rng):
    source, turn = rng.normal(size=(3, 3)), random_rotation(rng)
    fit = fit_similarity(source, source @ turn.T)
    assert np.abs(fit.rotation - turn).max() < 1e-9
    fit = fit_similarity(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[5.0, 5.0], [5.0, 8.0]]))
    assert np.abs(fit.apply(np.array([[0.0, 1.0]])) - [2.0, 5.0]).max() < 1e-9


def test_points_without_weight_do_not_count(rng):
    source = rng.normal(size=(5, 2))
    target = 3.0 * source + 1.0
    target[4] += 100.0
    fit = fit_similarity(source, target, weight=np.array([1.0, 1.0, 1.0, 1.0, 0.0]))
    assert np.abs(fit.apply(source[:4]) - target[:4]).max() < 1e-9


def test_a_mirror_is_never_the_answer(rng):
    source = rng.normal(size=(6, 3))
    fit = fit_similarity(source, source * [1.0, 1.0, -1.0])
    assert np.linalg.det(fit.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        (np.zeros((2, 3)), "fewer than 3 points"),
        (np.outer(np.arange(4.0), [1.0, 2.0, 3.0]), "in a line"),
        (np.ones((4, 2)), "at one spot"),
    ],
)
def test_what_does_not_determine_it_is_no_similarity(source, reason):
    fit = fit_similarity(source, source)
    assert not fit
    assert isinstance(fit, NoSimilarity)
    assert reason in fit.reason
