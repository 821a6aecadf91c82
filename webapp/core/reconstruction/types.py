"""How the photos of a map were held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

USABLE_TRUST = 0.5
"""Sum of the trust in agreeing pairs from which on an orientation is used."""


@dataclass(frozen=True, slots=True, eq=False)
class Orientations:
    """How p photos were held.

    Attributes
    ----------
    rotation : (p, 3, 3) float64
        Camera from world.
    height : (p,) float64
        Downwards from the others', map pixels.
    trust : (p,) float64
        Sum of the trust in the pairs that agree with it; 0 where nothing is known.
    """

    rotation: NDArray[np.float64]
    height: NDArray[np.float64]
    trust: NDArray[np.float64]
