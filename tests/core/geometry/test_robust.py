"""Robust kernels and the annealing of their width."""

import numpy as np
import pytest

from webapp.core.geometry.robust import Annealing, cauchy, geman_mcclure, truncated_quadratic

RESIDUAL = np.linspace(0.0, 50.0, 200)


@pytest.mark.parametrize("kernel", [geman_mcclure, cauchy, truncated_quadratic])
def test_weights_fall_from_one_towards_zero(kernel):
    weight = kernel(RESIDUAL**2, 1.0)
    assert weight[0] == 1.0
    assert (np.diff(weight) <= 0.0).all()
    assert weight[-1] < 1e-3


def test_the_influence_of_an_outlier_vanishes_sooner_with_geman_mcclure():
    influence = [RESIDUAL * kernel(RESIDUAL**2, 1.0) for kernel in (geman_mcclure, cauchy)]
    assert influence[0][-1] < 0.01 < influence[1][-1] < 0.1


def test_annealing_ends_at_one():
    factors = [*Annealing(rounds=10, start=8.0, decay=0.5).factors()]
    assert factors == [8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
