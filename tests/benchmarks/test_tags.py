"""The simulation of printed tags: errors, radii and the place that is named first."""

import numpy as np

from benchmarks.tags import simulate


def test_three_tags_are_more_exact_than_one():
    rng = np.random.default_rng(0)
    one, three = (
        np.median([simulate(n, 3.0, focal_sigma=0.01, headings=True, rng=rng)[0] for _ in range(12)])
        for n in (1, 3)
    )
    assert three < 0.7 * one < 0.2
