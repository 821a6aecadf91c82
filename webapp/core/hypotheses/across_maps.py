"""Probabilities over several maps, from the probability that each gives by itself.

Each map gives the probability p that a photo was taken on it rather than on none. At most one of the maps is
right, so each map has the odds p / (1 - p) against none, and

    P(map m) = odds_m / (1 + sum of all odds),    P(none) = 1 / (1 + sum of all odds).

With a single map this is p itself. Maps that show the same place share its probability.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_CERTAIN = 1e-6
"""Probabilities are clipped to this distance from 0 and 1."""


def probabilities_over_maps(on_map: Sequence[float]) -> tuple[list[float], float]:
    """Combine the probabilities of several maps for a photo.

    Args:
        on_map: For each map by itself, the probability that the photo was taken on it.

    Returns:
        Probability of each map; they and the next value add up to 1.
        That it was taken on none of them.
    """
    p = np.clip(np.asarray(on_map, dtype=np.float64), _CERTAIN, 1.0 - _CERTAIN)
    odds = p / (1.0 - p)
    total = 1.0 + float(odds.sum())
    return (odds / total).tolist(), 1.0 / total
