"""Maximum likelihood estimate of the noise of odometry and of each source of fixes, from the track itself.

Robots differ: the odometry of wheels that skid in turns is several times worse than that of rolling wheels.
Receivers know their noise but not their multipath errors; many send the dilution of precision instead of a
variance; a camera may be sure of a wrong place. So each fix is predicted from the ones before under several
assumptions, and the one under which the fixes are most likely is chosen (F. Schweppe, "Evaluation of
likelihood functions for Gaussian signals", IEEE Transactions on Information Theory 11, 1965). All sources are
estimated together: one that states too little would otherwise make the others look noisy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.records import Source
from webapp.missions.core.trajectory.smoother import OutlierLabels, log_likelihood
from webapp.missions.core.trajectory.steps import Fixes, Steps

ODOMETRY = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors on the usual errors of odometry."""

STATED: Mapping[Source, tuple[float, ...]] = {"gps": (1.0, 2.0, 4.0), "visual": (1.0, 2.0, 4.0, 8.0)}
"""Factors on the stated standard deviations of a source: none below 1, as none is better than it states.

Positions set by hand are believed."""

MOTION = (1 / 8, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Factors on the usual velocity, for a track without odometry."""

FIRST = (1.0, 2.0)
"""Factors on the odometry under which several sources are compared, before its own factor is refined."""


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """Factors on the assumed standard deviations."""

    odometry: float = 1.0
    stated: Mapping[Source, float] = field(default_factory=dict)  # By source; 1 where it is missing
    motion: float = 1.0  # On the velocity, of a track without odometry

    def noise(self, usual: Noise) -> Noise:
        """Return the scaled noise of the odometry."""
        by = self.odometry
        return replace(
            usual,
            forward=usual.forward * by,
            sideways=usual.sideways * by,
            heading=usual.heading * by,
            turning=usual.turning * by,
            scale=usual.scale * by,
            turn_scale=usual.turn_scale * by,
            curve=usual.curve * by,
            velocity=usual.velocity * self.motion,
        )

    def fixes(self, stated: Fixes, *, source: NDArray[np.str_]) -> Fixes:
        """Return the fixes with scaled covariances.

        Args:
            source: (m,) str. Where each came from.
        """
        by = np.ones(len(stated))
        for name, factor in self.stated.items():
            by[source == name] = factor**2
        return replace(stated, covariance=stated.covariance * by[:, None, None])


def fit(
    steps: Steps,
    fixes: Fixes,
    *,
    source: NDArray[np.str_],
    usual: Noise,
    judged: Callable[[Fixes, NoiseFit], OutlierLabels | None] = lambda *_: None,
) -> NoiseFit:
    """Estimate the noise of the odometry and of each source of fixes.

    Args:
        steps, fixes: A sample of the track is enough: it is filtered once for each assumption.
        source: (m,) str. Where each fix came from.
        judged: Finds outliers under assumed covariances and motion, as they are no evidence of a noisy
            source. The judgement is used if it makes the fixes likelier.
    """
    present = [name for name in STATED if (source == name).any()]
    stated = [dict(zip(present, by, strict=True)) for by in product(*(STATED[name] for name in present))]
    scaled = [NoiseFit(stated=one).fixes(fixes, source=source) for one in stated]
    reckoned = bool(np.isfinite(steps.moves).any())
    judgements: dict[tuple[float, int], OutlierLabels | None] = {}

    def likelihood(by: float, which: int) -> float:
        assumed = NoiseFit(by) if reckoned else NoiseFit(motion=by)
        at = (1.0 if reckoned else by, which)
        if at not in judgements:
            judgements[at] = judged(scaled[which], NoiseFit(motion=at[0]))
        return max(
            log_likelihood(steps, scaled[which], noise=assumed.noise(usual), judged=judgement)
            for judgement in (None, judgements[at])
        )

    every = ODOMETRY if reckoned else MOTION
    first = every if len(present) < 2 or not reckoned else [one for one in every if one in FIRST]
    found = {pair: likelihood(*pair) for pair in product(first, range(len(stated)))}
    best = max(found, key=lambda pair: found[pair])[1]
    found |= {(by, best): likelihood(by, best) for by in every if (by, best) not in found}
    by, which = max(found, key=lambda pair: found[pair])
    return NoiseFit(by, stated[which]) if reckoned else NoiseFit(1.0, stated[which], by)
