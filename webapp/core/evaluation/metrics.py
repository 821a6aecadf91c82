"""Metrics of an evaluation, computed from plain arrays.

In every function `errors` is an (n,) float64 array with the distance of each query's first hypothesis from
the truth, map pixels; it is infinite for a query without a hypothesis, which is thus a miss at any radius.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.evaluation.types import Grade, Interval, ReliabilityBin

GRADES: tuple[tuple[Grade, float], ...] = (
    ("excellent", 0.5),
    ("good", 1.0),
    ("sufficient", 2.0),
    ("insufficient", np.inf),
)
"""Grades and their largest errors, in multiples of the map's `place_radius_px`."""

BINS = 10
"""Bins of the calibration error and of the reliability diagram."""

REPLICATES = 1000
"""Resamples of a bootstrap interval."""


def grade(error: float, place_radius_px: float) -> Grade:
    """Grade an error: excellent up to half the place radius, good up to 1, sufficient up to 2.

    Args:
        error, place_radius_px: Map pixels; an error may be infinite.

    Returns:
        {"excellent", "good", "sufficient", "insufficient"}
    """
    return next(word for word, limit in GRADES if error <= limit * place_radius_px)


def median_error(errors: NDArray[np.float64]) -> float | None:
    """Compute the median over the queries with a hypothesis; None if no query has one."""
    known = errors[np.isfinite(errors)]
    return float(np.median(known)) if known.size else None


def mean_error(errors: NDArray[np.float64]) -> float | None:
    """Compute the mean over the queries with a hypothesis; None if no query has one."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if known.size else None


def share_within(errors: NDArray[np.float64], radius_px: float) -> float:
    """Compute the share of all queries whose error is at most `radius_px`."""
    return float(np.mean(errors <= radius_px))


def reliability_bins(probabilities: ArrayLike, right: ArrayLike) -> tuple[ReliabilityBin, ...]:
    """Sort the queries by probability and divide them into ten bins of equal mass.

    Queries of equal probability all get their average share of right answers, so that their order does not
    matter if a bin ends among them.

    Args:
        probabilities: (n,) float64. Of each query's first hypothesis.
        right: (n,) bool. Whether it is right.

    Returns:
        Least probable first; fewer than ten for fewer than ten queries.
    """
    stated = np.asarray(probabilities, dtype=np.float64)
    values, group, counts = np.unique(stated, return_inverse=True, return_counts=True)
    hits = np.bincount(group, weights=np.asarray(right, dtype=np.float64), minlength=values.size)
    expected = (hits / counts)[group]
    order = np.argsort(stated, kind="stable")
    parts = np.array_split(order, min(BINS, order.size)) if order.size else []
    return tuple(
        ReliabilityBin(float(stated[part].mean()), float(expected[part].mean()), int(part.size))
        for part in parts
    )


def expected_calibration_error(probabilities: ArrayLike, right: ArrayLike) -> float | None:
    """Compute the mean |stated probability - share of right answers| over the bins, weighted by mass.

    Args:
        probabilities: (n,) float64
        right: (n,) bool

    Returns:
        0 to 1, 0 is perfect; None without queries.

    References:
        Naeini, Cooper, Hauskrecht, "Obtaining well calibrated probabilities using Bayesian binning", AAAI
        2015; with bins of equal mass: Nguyen, O'Connor, "Posterior calibration and exploratory analysis for
        natural language processing models", EMNLP 2015.
    """
    bins = reliability_bins(probabilities, right)
    total = sum(b.count for b in bins)
    return sum(b.count * abs(b.probability - b.right) for b in bins) / total if total else None


def radius_coverage(errors: ArrayLike, radii: ArrayLike, *, place_radius_px: float) -> float | None:
    """Compute the share of the right hypotheses whose stated radius contains the truth.

    Args:
        errors: (n,) float64
        radii: (n,) float64. Stated 68 % radii, map pixels; NaN if none was stated.
        place_radius_px: Maximum error of a right hypothesis.

    Returns:
        None if no right hypothesis states a radius.
    """
    distance, radius = np.asarray(errors, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    counted = (distance <= place_radius_px) & np.isfinite(radius)
    return float(np.mean(distance[counted] <= radius[counted])) if counted.any() else None


def answered_at_precision(
    probabilities: ArrayLike, right: ArrayLike, *, queries: int, precision: float = 0.99
) -> float:
    """Compute the largest share of queries answered by a threshold on the probability at this precision.

    Args:
        probabilities: (n,) float64. Of the queries with a hypothesis.
        right: (n,) bool
        queries: Number of all queries, including those without a hypothesis.
        precision: Required share of right answers among the answered.

    Returns:
        0 when no threshold is good enough.
    """
    stated = np.asarray(probabilities, dtype=np.float64)
    order = np.argsort(-stated, kind="stable")
    hits = np.cumsum(np.asarray(right, dtype=np.int64)[order])
    answered = np.arange(1, order.size + 1)
    # a threshold cannot separate equal probabilities: allow a cut only after the last of them
    cut = np.append(np.diff(stated[order]) < 0, True)[: order.size]
    good = cut & (hits >= precision * answered - 1e-9)
    return float(answered[good].max() / queries) if good.any() else 0.0


def error_curve(errors: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the empirical distribution of the errors over all queries.

    Returns:
        errors: (m,) float64. Distinct finite errors, ascending.
        shares: (m,) float64. Share of all queries with at most this error; the last is below 1 if hypotheses
            are missing.
    """
    values, counts = np.unique(errors[np.isfinite(errors)], return_counts=True)
    return values, np.cumsum(counts) / max(errors.size, 1)


def bootstrap_interval(
    statistic: Callable[[NDArray[np.intp]], float | None],
    queries: int,
    *,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
) -> Interval | None:
    """Compute a 95 % percentile bootstrap interval over the queries.

    Args:
        statistic: Takes the indices of a resample, (queries,) int, and returns the metric or None.

    Returns:
        None if the metric is None for all resamples.

    References:
        Efron, Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13.
    """
    draws = (statistic(rng.integers(0, queries, queries)) for _ in range(replicates))
    figures = [figure for figure in draws if figure is not None]
    if not figures:
        return None
    low, high = np.percentile(figures, [2.5, 97.5])
    return float(low), float(high)


def wilson_interval(share: float, count: int) -> Interval:
    """Compute the 95 % interval of a share that was observed in `count` trials.

    References:
        E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
    """
    z2 = 1.96**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = 1.96 * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return float(max(0.0, middle - half)), float(min(1.0, middle + half))
