"""Prior from a circle on the map in or near which the photo was probably taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.hypotheses.bayes import reweight
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.path_prior import PathPrior

Array = NDArray[np.float64]

_EDGE = 0.5
"""Standard deviation of the truth beyond the rim of the circle, radii: the rim is only approximate."""

_OUTLIER_SHARE = 0.1
"""Share of circles without information: of another day or place, or of a receiver between buildings."""


@dataclass(frozen=True, slots=True)
class CirclePrior:
    """Circle in or near which the photo was taken; map pixels."""

    x: float
    y: float
    radius: float

    def density(self, position: Array) -> Array:
        """Compute the density at (n, 2) positions relative to that at the centre; (n,)."""
        beyond = np.maximum(np.hypot(*(position - (self.x, self.y)).T) - self.radius, 0.0)
        density: Array = np.exp(-0.5 * (beyond / (_EDGE * self.radius)) ** 2)
        return density


def apply_circle_prior(answer: Answer, near: CirclePrior, *, paths: PathPrior) -> Answer:
    """Reweight the hypotheses of an answer by a circle.

    The circle restricts the prior over places from the whole map to its surroundings, except for the tenth of
    circles without information. It says little about whether the photo is on the map: see `reweight`.

    Args:
        paths: Paths of the map.

    Returns:
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    if not answer.hypotheses:
        return answer
    inside = near.density(np.array([h.position for h in answer.hypotheses]))
    # A circle contains at least one place, even if no photo of the map is in it.
    usual = max(float(near.density(paths.photos).mean()), 1.0 / paths.places)
    return reweight(answer, [_OUTLIER_SHARE + (1.0 - _OUTLIER_SHARE) * i / usual for i in inside.tolist()])


def photo_weights(near: CirclePrior, paths: PathPrior) -> Array:
    """Compute the prior weight of the surroundings of each photo of `paths`; (n,)."""
    return _OUTLIER_SHARE / paths.places + (1.0 - _OUTLIER_SHARE) * near.density(paths.photos)
