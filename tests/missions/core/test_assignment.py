"""Assignment of columns to rows: minimal sum for few competitors, greedy for many."""

import itertools

import numpy as np
import pytest

from webapp.missions.core.trajectory import association
from webapp.missions.core.trajectory.association import MOST_TOGETHER, assign, linear_assignment


@pytest.mark.parametrize("seed", range(20))
def test_the_assignment_has_the_least_sum(seed):
    rng = np.random.default_rng(seed)
    n, m = sorted(rng.integers(1, 6, 2).tolist())
    costs = rng.normal(0, 5, (n, m)).round(1)
    chosen = linear_assignment(costs)
    assert len(set(chosen)) == n
    least = min(sum(costs[range(n), list(p)]) for p in itertools.permutations(range(m), n))
    assert costs[range(n), chosen].sum() == pytest.approx(least)


def test_as_many_rows_as_can_be_get_a_column():
    assert assign([{7: 1.0, 8: 50.0}, {7: 2.0}]) == {0: 8, 1: 7}
    assert assign([{7: 1.0}, {7: 2.0}, {}]) == {0: 7}
    assert assign([]) == {}


@pytest.fixture
def sizes(monkeypatch):
    """Numbers of rows that were assigned together."""
    found = []

    def counted(costs):
        found.append(len(costs))
        return linear_assignment(costs)

    monkeypatch.setattr(association, "linear_assignment", counted)
    return found


def test_rows_that_share_no_column_are_assigned_alone(sizes):
    chain = [{n: 1.0, n + 1: 2.0} for n in range(10, 13)]
    assert assign([{1: 1.0}, {}, *chain, {2: 0.0}]) == {0: 1, 2: 10, 3: 11, 4: 12, 5: 2}
    assert sizes == [1, 3, 1]


def test_more_rows_than_can_be_assigned_together_get_the_cheapest_pairs(sizes):
    rows = [{n: 1.0, n + 1: 0.5} for n in range(MOST_TOGETHER + 1)]
    assert assign(rows) == {n: n + 1 for n in range(MOST_TOGETHER + 1)}
    assert sizes == []
