"""How wrong odometry and receiver are, as the track itself shows.

Robots differ: wheels that skid in turns are several times worse than wheels that roll. And receivers know
their noise but not what reflections do; many send the dilution of precision instead of a variance. So the
fixes are predicted, each from those before it, under several assumptions, and the one under which they are
most likely is taken (F. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE
Transactions on Information Theory 11, 1965).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.trajectory.motion import Noise
from webapp.core.trajectory.smoother import Judgement, log_likelihood
from webapp.core.trajectory.steps import Fixes, Steps

ODOMETRY = (0.25, 0.5, 1.0, 2.0, 4.0)
"""The usual errors of odometry times this."""

RECEIVER = (1.0, 2.0, 4.0)
"""Factors on a receiver's stated standard deviations: none below 1, as it is never better than stated."""


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """By what the assumed errors are multiplied.

    Attributes
    ----------
    odometry, receiver : float
        Standard deviations.
    """

    odometry: float = 1.0
    receiver: float = 1.0

    def noise(self, usual: Noise) -> Noise:
        """Return the noise of the odometry."""
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
        )

    def fixes(self, stated: Fixes, *, of_receiver: NDArray[np.bool_]) -> Fixes:
        """Return the fixes with the covariances that they have in truth.

        Parameters
        ----------
        of_receiver : (m,) bool
            Which came from a satellite receiver.
        """
        by = np.where(of_receiver, self.receiver**2, 1.0)
        return replace(stated, covariance=stated.covariance * by[:, None, None])


def fit(
    steps: Steps,
    fixes: Fixes,
    *,
    of_receiver: NDArray[np.bool_],
    usual: Noise,
    judged: Callable[[Fixes], Judgement | None] = lambda _: None,
) -> NoiseFit:
    """Find how wrong odometry and receiver are.

    Parameters
    ----------
    steps, fixes : Steps, Fixes
        A sample of the track is enough: it is filtered once for each assumption.
    of_receiver : (m,) bool
        Which fixes came from a satellite receiver.
    judged : callable
        Judges the fixes under an assumed covariance, as wrong ones are no evidence of a bad receiver. It
        counts where that makes the fixes likelier.
    """
    with_odometry = bool(np.isfinite(steps.moves).any())
    assumed = [
        NoiseFit(odometry, receiver)
        for odometry in (ODOMETRY if with_odometry else (1.0,))
        for receiver in (RECEIVER if of_receiver.any() else (1.0,))
    ]
    judgements = {
        factor: judged(NoiseFit(1.0, factor).fixes(fixes, of_receiver=of_receiver))
        for factor in {one.receiver for one in assumed}
    }
    likelihoods = [
        max(
            log_likelihood(
                steps, one.fixes(fixes, of_receiver=of_receiver), noise=one.noise(usual), judged=judgement
            )
            for judgement in (None, judgements[one.receiver])
        )
        for one in assumed
    ]
    return assumed[int(np.argmax(likelihoods))]
