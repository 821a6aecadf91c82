"""What a circle says about the hypotheses: about there the photo was taken, as a rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.hypotheses.bayes import reweight
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.path_prior import PathPrior

Array = NDArray[np.float64]

_EDGE = 0.5
"""Spread of the truth about the rim of the circle, radii: nobody knows exactly where a circle ends."""

_ASTRAY = 0.1
"""Share of circles that say nothing: of another day, of another place, of a receiver between houses."""


@dataclass(frozen=True, slots=True)
class CirclePrior:
    """About where the photo was taken: map pixels."""

    x: float
    y: float
    radius: float

    def density(self, position: Array) -> Array:
        """Compute how probable (n, 2) positions are, over the probability of the middle; (n,)."""
        beyond = np.maximum(np.hypot(*(position - (self.x, self.y)).T) - self.radius, 0.0)
        density: Array = np.exp(-0.5 * (beyond / (_EDGE * self.radius)) ** 2)
        return density


def apply_circle_prior(answer: Answer, near: CirclePrior, *, paths: PathPrior) -> Answer:
    """Weigh the hypotheses of an answer with where the photo is said to have been taken, by Bayes' rule.

    The circle changes the prior over places from all of the map to about the circle, except for the tenth of
    circles that say nothing. It hardly says whether the map knows what the photo shows: see `weighed`.

    Parameters
    ----------
    paths : Paths
        The places that there are.

    Returns
    -------
    Answer
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    if not answer.hypotheses:
        return answer
    inside = near.density(np.array([h.position for h in answer.hypotheses]))
    # A circle holds at least one place, also where no photo of the map stands just there.
    usual = max(float(near.density(paths.photos).mean()), 1.0 / paths.places)
    return reweight(answer, [_ASTRAY + (1.0 - _ASTRAY) * i / usual for i in inside.tolist()])


def photo_weights(near: CirclePrior, paths: PathPrior) -> Array:
    """Compute how probable the surroundings of each photo of `paths` are; (n,)."""
    return _ASTRAY / paths.places + (1.0 - _ASTRAY) * near.density(paths.photos)
