"""Maximum likelihood estimate of the noise of odometry and receiver, from the track itself.

Robots differ: the odometry of wheels that skid in turns is several times worse than that of rolling wheels.
Receivers know their noise but not their multipath errors; many send the dilution of precision instead of a
variance. So each fix is predicted from the ones before under several assumptions, and the one under which the
fixes are most likely is chosen (F. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE
Transactions on Information Theory 11, 1965).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.smoother import OutlierLabels, log_likelihood
from webapp.missions.core.trajectory.steps import Fixes, Steps

ODOMETRY = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors on the usual errors of odometry."""

RECEIVER = (1.0, 2.0, 4.0)
"""Factors on a receiver's stated standard deviations: none below 1, as it is never better than stated."""


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """Factors on the assumed errors."""

    # `odometry`, `receiver`: Factors on standard deviations.
    odometry: float = 1.0
    receiver: float = 1.0

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
        )

    def fixes(self, stated: Fixes, *, of_receiver: NDArray[np.bool_]) -> Fixes:
        """Return the fixes with scaled covariances.

        Args:
            of_receiver: (m,) bool. Which came from a satellite receiver.
        """
        by = np.where(of_receiver, self.receiver**2, 1.0)
        return replace(stated, covariance=stated.covariance * by[:, None, None])


def fit(
    steps: Steps,
    fixes: Fixes,
    *,
    of_receiver: NDArray[np.bool_],
    usual: Noise,
    judged: Callable[[Fixes], OutlierLabels | None] = lambda _: None,
) -> NoiseFit:
    """Estimate the noise of odometry and receiver.

    Args:
        steps, fixes: A sample of the track is enough: it is filtered once for each assumption.
        of_receiver: (m,) bool. Which fixes came from a satellite receiver.
        judged: Finds outliers under an assumed covariance, as they are no evidence of a noisy receiver. The
            judgement is used if it makes the fixes likelier.
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
