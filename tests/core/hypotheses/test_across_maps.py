"""Probabilities over several maps."""

import pytest

from webapp.core.hypotheses.across_maps import probabilities_over_maps


def test_one_map_says_what_it_says_by_itself():
    each, none = probabilities_over_maps([0.7])
    assert each == pytest.approx([0.7]) and none == pytest.approx(0.3)


def test_no_map_leaves_none():
    assert probabilities_over_maps([]) == ([], 1.0)


def test_what_one_map_is_sure_of_counts_against_the_others():
    each, none = probabilities_over_maps([0.99, 0.5, 0.01])
    assert sum(each) + none == pytest.approx(1.0)
    assert each[0] == pytest.approx(99 / (1 + 99 + 1 + 1 / 99))
    assert each[1] < 0.01 and each[1] == pytest.approx(none)


def test_maps_of_one_place_share_it_and_certainty_is_no_division_by_zero():
    each, none = probabilities_over_maps([1.0, 1.0, 0.0])
    assert each[:2] == pytest.approx([0.5, 0.5], abs=1e-5) and none < 1e-5
