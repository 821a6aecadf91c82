"""From evidence to probabilities: a softmax over the places found and "not on this map".

The weight of a place is linear in its evidence. Its odds against "not on this map" grow like the exponential
of the weight, but are near zero without evidence: places that are merely named do not add up to a
probability of being on the map, however many they are. The probabilities are the softmax of the log-odds, so
that they add up to 1. The coefficients are fitted on the map's own photos, hidden in turn; `DEFAULT` is used
until then, and the fit is regularised towards it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EVIDENCE = 6
"""Number of evidence values of one place; `localize.evidence` computes them."""

_GLOBAL = 5
"""Index of the value from the global descriptor. Without a model it is zero everywhere and then left out of
the computation, so that results are the same to the last bit."""

_SHARPNESS = 4.0
"""Slope of the log-odds where the weight is negative; where it is large, the slope is 1. It is finite, so
that weak evidence keeps its order."""

_LEAST = 1e-300
"""Added to positive numbers whose logarithm or reciprocal is needed."""

_PRIOR_WEIGHT = 1.0
"""Strength of the penalty towards the default, in units of one photo; times the root of their number."""

_STEPS = 60
_CONVERGED = 1e-6


@dataclass(frozen=True, slots=True)
class Calibration:
    """Coefficients of a map and a method."""

    slope: tuple[float, ...]
    offset: float  # Log-odds of a place against "not on this map", minus its weight if that is large
    radius_scale: float  # 68 % radius over the standard deviation of an estimated position
    # Standard deviation of a query's distance from the best-matching photo, place radii.
    photo_sigma: float = 1.5
    schematic: bool = False  # Whether computed positions contradict the map, so that answers name photos
    cases: int = 0  # Number of photos that it was fitted on; 0 for the default


DEFAULT = Calibration(slope=(0.7, 0.3, 2.7, 0.6, 1.2, 0.0), offset=-3.0, radius_scale=1.0)
"""Fitted on the queries of maps of several kinds, each with the same weight; see `benchmarks/battery.py`.
The weight of a global descriptor depends on its model and is fitted on the map's own photos."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One photo with known place, and the places found for it."""

    evidence: NDArray[np.float64]  # (h, EVIDENCE) float64. Evidence of each hypothesis.
    # (h,) bool. Whether each is within the place radius of the truth; all False when the photo's place was
    # hidden.
    right: NDArray[np.bool_]
    weight: float = 1.0


def weigh(evidence: NDArray[np.float64], calibration: Calibration) -> NDArray[np.float64]:
    """Sum the evidence of each place times the slopes: log-odds without the offset; (h,)."""
    used = _used(calibration, [evidence])
    weight: NDArray[np.float64] = np.ascontiguousarray(evidence[:, :used]) @ np.array(
        calibration.slope[:used]
    )
    return weight


def _used(calibration: Calibration, evidence: Sequence[NDArray[np.float64]]) -> int:
    """Count the evidence values in use: the last one only if there is a global descriptor."""
    without = len(calibration.slope) == EVIDENCE and not any(e[:, _GLOBAL:].any() for e in evidence)
    return _GLOBAL if without else len(calibration.slope)


def log_odds(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert weights of places to log-odds without the offset: log(exp(weight) - 1), smoothed at zero."""
    smooth = _softplus(weight)
    odds: NDArray[np.float64] = smooth + np.log(-np.expm1(-smooth))
    return odds


def _softplus(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positive part of weights, smoothed."""
    return np.logaddexp(0.0, _SHARPNESS * weight) / _SHARPNESS + _LEAST


def _log_odds_slope(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the derivative of `log_odds`, from `_SHARPNESS` down to 1."""
    rise = np.exp(-np.logaddexp(0.0, -_SHARPNESS * weight))
    slope: NDArray[np.float64] = rise / -np.expm1(-_softplus(weight))
    return slope


def probabilities(
    evidence: NDArray[np.float64], calibration: Calibration
) -> tuple[NDArray[np.float64], float]:
    """Convert evidence to probabilities.

    Args:
        evidence: (h, EVIDENCE) float64

    Returns:
        place: (h,) float64
        off_map: It and `place` add up to 1.
    """
    odds = log_odds(weigh(evidence, calibration)) + calibration.offset
    top = max(0.0, float(odds.max(initial=0.0)))
    grown, off = np.exp(odds - top), float(np.exp(-top))
    total = grown.sum() + off
    return grown / total, float(off / total)


def fit(cases: Sequence[Case], *, start: Calibration = DEFAULT) -> tuple[tuple[float, ...], float]:
    """Fit slope and offset by penalised maximum likelihood (projected Newton, Bertsekas 1982).

    The curvature of `log_odds` is left out of the Hessian (Fisher scoring), which keeps it positive definite.

    Args:
        start: The fit is regularised towards it, so that few cases change it little.

    Returns:
        slope: Not negative: more evidence never makes a place less probable.
    """
    used = _used(start, [c.evidence for c in cases])
    total = sum(c.weight for c in cases)
    if not total:
        return start.slope, start.offset
    stack = _Stack.of(cases, used)
    prior = np.array([*start.slope[:used], start.offset])
    penalty = _PRIOR_WEIGHT * max(total, 1.0) ** 0.5
    theta = prior.copy()
    loss = _loss(stack, theta, prior=prior, penalty=penalty)
    for _ in range(_STEPS):
        gradient, hessian = stack.derivatives(theta)
        gradient, hessian = gradient + penalty * (prior - theta), hessian + penalty * np.eye(len(theta))
        # Slopes at zero that the gradient would make negative are fixed; solve for a step of the others.
        free = np.append((theta[:-1] > 0.0) | (gradient[:-1] > 0.0), True)
        step = np.zeros(len(theta))
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        before = theta
        theta, loss = _search(stack, theta, step, loss=loss, prior=prior, penalty=penalty)
        if np.abs(theta - before).max() < _CONVERGED:
            break
    return (*(float(t) for t in theta[:-1]), *start.slope[used:]), float(theta[-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """All cases, padded to arrays of one shape: twenty times as fast as a loop over the cases.

    Sums use einsum, so that they do not depend on the number of BLAS threads.
    """

    # (n, h + 1, k) float64. Evidence and 1 of each place; zeros for "not on this map", which is last, and for
    # padding.
    design: NDArray[np.float64]
    # `places`, `right`: (n, h + 1) bool. Which entries are not padding, and which are right.
    places: NDArray[np.bool_]
    right: NDArray[np.bool_]
    weight: NDArray[np.float64]  # (n,) float64

    @classmethod
    def of(cls, cases: Sequence[Case], used: int) -> _Stack:
        """Stack the first `used` values of the evidence."""
        most = max(len(c.right) for c in cases)
        design = np.zeros((len(cases), most + 1, used + 1))
        places, right = np.zeros((2, len(cases), most + 1), dtype=np.bool_)
        for row, case in enumerate(cases):
            count = len(case.right)
            design[row, :count, :used], design[row, :count, used] = case.evidence[:, :used], 1.0
            places[row, :count], right[row, :count] = True, case.right
        places[:, -1], right[:, -1] = True, ~right.any(axis=1)
        return cls(design, places, right, np.array([c.weight for c in cases]))

    def _weight(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        weight: NDArray[np.float64] = np.einsum("nhk,k->nh", self.design[..., :-1], theta[:-1])
        return weight

    def odds(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute log-odds against "not on this map", (n, h + 1); -inf for padding."""
        odds = log_odds(self._weight(theta)) + theta[-1]
        odds[:, -1] = 0.0
        return np.where(self.places, odds, -np.inf)

    def derivatives(self, theta: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute the gradient (k,) and the negated Hessian (k, k) of the log likelihood."""
        odds = self.odds(theta)
        p = np.exp(odds - odds.max(axis=1, keepdims=True))
        p /= p.sum(axis=1, keepdims=True)
        target = np.where(self.right, p, 0.0)
        target /= np.maximum(target.sum(axis=1, keepdims=True), 1e-300)
        design = self.design.copy()
        design[..., :-1] *= _log_odds_slope(self._weight(theta))[..., None]
        mean = np.einsum("nh,nhk->nk", p, design)
        gradient = np.einsum("n,nh,nhk->k", self.weight, target - p, design)
        weighted = design * (self.weight[:, None] * p)[:, :, None]
        curvature = np.einsum("nhj,nhk->jk", weighted, design)
        return gradient, curvature - np.einsum("n,nj,nk->jk", self.weight, mean, mean)


def _search(
    stack: _Stack,
    theta: NDArray[np.float64],
    step: NDArray[np.float64],
    *,
    loss: float,
    prior: NDArray[np.float64],
    penalty: float,
) -> tuple[NDArray[np.float64], float]:
    """Search along a step by backtracking, with slopes clipped at zero, until the loss falls."""
    length = 1.0 / max(1.0, float(np.abs(step).max()))
    while length > _CONVERGED:
        there = theta + length * step
        there[:-1] = np.maximum(there[:-1], 0.0)
        reached = _loss(stack, there, prior=prior, penalty=penalty)
        if reached < loss:
            return there, reached
        length /= 2.0
    return theta, loss


def _loss(stack: _Stack, theta: NDArray[np.float64], *, prior: NDArray[np.float64], penalty: float) -> float:
    """Compute the negative log likelihood plus the penalty."""
    odds = stack.odds(theta)
    right = np.where(stack.right, odds, -np.inf)
    surprise = np.logaddexp.reduce(odds, axis=1) - np.logaddexp.reduce(right, axis=1)
    return penalty * float(((theta - prior) ** 2).sum()) / 2.0 + float((stack.weight * surprise).sum())
