"""Results of an evaluation, and metrics over all of them.

In every function `errors` is an (n,) float64 array with the distance of each query's first hypothesis from
the truth, map pixels; it is infinite for a query without a hypothesis, which is thus a miss at any radius.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, MatchStatistics

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
) -> Interval | None:
    """Compute a 95 % percentile bootstrap interval over the queries.

    Args:
        statistic: Takes the indices of a resample, (queries,) int, and returns the metric or None.

    Returns:
        None if the metric is None for all resamples.

    References:
        Efron, Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13.
    """
    draws = (statistic(rng.integers(0, queries, queries)) for _ in range(REPLICATES))
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


WITHIN_PX = (10, 20, 50, 100, 400)
"""Radii of the shares, map pixels."""

TOP = 5
"""Number of hypotheses considered in `top5_within_50px`."""


@dataclass(frozen=True, slots=True)
class Outcomes:
    """The results as arrays, one element per query; missing values are NaN, missing errors infinite."""

    # `errors`, `best_of_top`: (n,) float64. Errors of the first hypothesis, and of the nearest of the first
    # five; map pixels.
    errors: NDArray[np.float64]
    best_of_top: NDArray[np.float64]
    # `probabilities`, `radii`: (n,) float64. Of the first hypothesis.
    probabilities: NDArray[np.float64]
    radii: NDArray[np.float64]

    def __getitem__(self, index: NDArray[np.intp]) -> Outcomes:
        """Select queries by their indices, which may be repeated."""
        return Outcomes(
            self.errors[index], self.best_of_top[index], self.probabilities[index], self.radii[index]
        )


def outcomes(results: Sequence[QueryResult]) -> Outcomes:
    count = len(results)
    found = Outcomes(
        np.full(count, np.inf), np.full(count, np.inf), np.full(count, np.nan), np.full(count, np.nan)
    )
    for i, result in enumerate(results):
        if result.answer is None or not result.answer.hypotheses:
            continue
        first = result.answer.hypotheses[0]
        found.errors[i] = result.errors_px[0]
        found.best_of_top[i] = min(result.errors_px[:TOP])
        found.probabilities[i] = first.probability
        found.radii[i] = np.nan if first.radius_px is None else first.radius_px
    return found


def figures(place_radius_px: float) -> dict[str, Callable[[Outcomes], float | None]]:
    """Return the functions that compute the metrics, by their names in JSON.

    Args:
        place_radius_px: Largest error at which a hypothesis is right, map pixels.
    """

    def within(radius: int) -> Callable[[Outcomes], float | None]:
        return lambda o: share_within(o.errors, radius)

    def stated(o: Outcomes) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        has = np.isfinite(o.probabilities)  # not by errors, which are infinite on a wrong floor
        return o.probabilities[has], o.errors[has] <= place_radius_px

    return {
        "median_px": lambda o: median_error(o.errors),
        "mean_px": lambda o: mean_error(o.errors),
        **{f"within_{radius}px": within(radius) for radius in WITHIN_PX},
        "top5_within_50px": lambda o: share_within(o.best_of_top, 50),
        "ece": lambda o: expected_calibration_error(*stated(o)),
        "radius_coverage": lambda o: radius_coverage(o.errors, o.radii, place_radius_px=place_radius_px),
        "answered_at_99_precision": lambda o: answered_at_precision(*stated(o), queries=o.errors.size),
    }


def summarise(results: Sequence[QueryResult], *, place_radius_px: float, rng: np.random.Generator) -> Summary:
    """Compute all metrics of an evaluation.

    Args:
        results: At least one.
        place_radius_px: Largest error at which a hypothesis is right, map pixels.
    """
    found = outcomes(results)
    recipes = figures(place_radius_px)
    values = {name: figure(found) for name, figure in recipes.items()}
    has = np.isfinite(found.probabilities)
    grades = Counter(grade(float(error), place_radius_px) for error in found.errors)
    return Summary(
        queries=len(results),
        failed=sum(r.answer is None for r in results),
        abstained=sum(r.answer is not None and r.answer.abstained for r in results),
        second_looks=sum(r.answer is not None and len(r.answer.looks) > 1 for r in results),
        median_px=values["median_px"],
        mean_px=values["mean_px"],
        within={radius: values[f"within_{radius}px"] or 0.0 for radius in WITHIN_PX},
        top5_within_50px=values["top5_within_50px"] or 0.0,
        ece=values["ece"],
        radius_coverage=values["radius_coverage"],
        answered_at_99_precision=values["answered_at_99_precision"] or 0.0,
        seconds_per_query_p50=_percentile((r.total_seconds for r in results), 50),
        seconds_per_query_p95=_percentile((r.total_seconds for r in results), 95),
        extract_seconds_p50=_percentile((r.extract_seconds for r in results), 50),
        match_seconds_p50=_percentile((r.match_seconds for r in results), 50),
        grades={word: grades[word] for word, _ in GRADES},
        intervals=_intervals(found, recipes, rng),
        reliability=reliability_bins(found.probabilities[has], found.errors[has] <= place_radius_px),
    )


def _intervals(
    found: Outcomes, recipes: dict[str, Callable[[Outcomes], float | None]], rng: np.random.Generator
) -> dict[str, Interval]:
    intervals = {}
    for name, figure in recipes.items():
        interval = bootstrap_interval(_of_sample(found, figure), found.errors.size, rng=rng)
        if interval is not None:
            intervals[name] = interval
    return intervals


def _of_sample(
    found: Outcomes, figure: Callable[[Outcomes], float | None]
) -> Callable[[NDArray[np.intp]], float | None]:
    return lambda index: figure(found[index])


def _percentile(seconds: Iterable[float | None], percent: float) -> float | None:
    known = [s for s in seconds if s is not None]
    return float(np.percentile(known, percent)) if known else None


@dataclass(frozen=True, slots=True)
class Row:
    """Row of one query in the table of an experiment."""

    result: QueryResult
    statistics: MatchStatistics | None  # None for a photo that could not be used
    seconds: float | None  # From the photo's file to the answer
    grade_first: Grade  # Of the first hypothesis; "insufficient" without one
    # Of the nearest of the other hypotheses, to show whether one of them would help; None without others.
    grade_others: Grade | None
    # `first_px`, `worst_px`: Error of the first hypothesis and of the farthest one, map pixels.
    first_px: float | None
    worst_px: float | None
    # `first_m`, `worst_m`: The same in metres, on a map with a georeference.
    first_m: float | None
    worst_m: float | None


def row(result: QueryResult, *, place_radius_px: float, metres_per_pixel: float | None) -> Row:
    """Build one row of the table.

    Args:
        place_radius_px: Unit of the errors for grades.
        metres_per_pixel: Size of a map pixel at the true position; None without a georeference.
    """
    errors = result.errors_px
    others = errors[1:]
    first_px, worst_px = (errors[0], max(errors)) if errors else (None, None)
    return Row(
        result=result,
        statistics=None if result.answer is None else result.answer.statistics,
        seconds=result.total_seconds,
        grade_first=grade(errors[0], place_radius_px) if errors else "insufficient",
        grade_others=grade(min(others), place_radius_px) if others else None,
        first_px=first_px,
        worst_px=worst_px,
        first_m=_metres(first_px, metres_per_pixel),
        worst_m=_metres(worst_px, metres_per_pixel),
    )


def _metres(pixels: float | None, metres_per_pixel: float | None) -> float | None:
    # beyond the horizon of a tilted image the size of a pixel is undefined
    if pixels is None or metres_per_pixel is None or not math.isfinite(metres_per_pixel):
        return None
    return pixels * metres_per_pixel


Grade = Literal["excellent", "good", "sufficient", "insufficient"]
Interval = tuple[float, float]

_MATCHING_STAGES = ("retrieve", "verify", "position")


@dataclass(frozen=True, slots=True)
class QueryResult:
    """One query: its true position, and the answer of localization."""

    path: str  # As in the list of queries
    truth: MapPixel  # True position of the photo
    answer: Answer | None  # None for a photo that could not be used
    error: str | None = None  # Why there is no answer
    truth_heading_deg: float | None = None  # True viewing direction, degrees clockwise from north, if known
    truth_floor: int | None = None  # Id of the true floor, if known

    @property
    def errors_px(self) -> tuple[float, ...]:
        """Distance of each hypothesis from the truth, map pixels, in the order of their ranks.

        It is infinite for a hypothesis on another floor than the truth.
        """
        if self.answer is None:
            return ()
        return tuple(
            math.dist(h.position, self.truth) if self.truth_floor in (None, h.floor) else math.inf
            for h in self.answer.hypotheses
        )

    @property
    def error_px(self) -> float | None:
        """Distance of the first hypothesis from the truth, map pixels; None without one on its floor."""
        errors = self.errors_px
        return errors[0] if errors and math.isfinite(errors[0]) else None

    @property
    def extract_seconds(self) -> float | None:
        """Time spent on the photo's keypoints and descriptors."""
        return None if self.answer is None else self.answer.seconds.get("extract")

    @property
    def match_seconds(self) -> float | None:
        """Time spent on everything between the descriptors and the answer."""
        if self.answer is None:
            return None
        spent = [self.answer.seconds[stage] for stage in _MATCHING_STAGES if stage in self.answer.seconds]
        return sum(spent) if spent else None

    @property
    def total_seconds(self) -> float | None:
        """Time from the photo's file to the answer."""
        return None if self.answer is None else self.answer.seconds.get("total")


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Queries with a similar stated probability."""

    probability: float  # Mean stated probability
    right: float  # Share of right answers
    count: int  # Queries in the bin


@dataclass(frozen=True, slots=True)
class Summary:
    """Metrics over all queries; None if undefined."""

    # `queries`, `failed`, `abstained`, `second_looks`: All queries; photos that could not be used; answers
    # "not on this map"; photos with a second look.
    queries: int
    failed: int
    abstained: int
    second_looks: int
    # `median_px`, `mean_px`: Error of the first hypothesis, over the queries that have one.
    median_px: float | None
    mean_px: float | None
    # Share of all queries whose first hypothesis is at most this many map pixels off.
    within: Mapping[int, float]
    # Share of all queries with one of the first five hypotheses at most 50 map pixels off.
    top5_within_50px: float
    ece: float | None  # Expected calibration error of the first hypothesis' probability
    # Share of the right hypotheses whose `radius_px` contains the truth; ideally 0.68.
    radius_coverage: float | None
    # Share of all queries that can be answered, the most probable first, with 99 % of the answers right.
    answered_at_99_precision: float
    seconds_per_query_p50: float | None
    seconds_per_query_p95: float | None
    extract_seconds_p50: float | None
    match_seconds_p50: float | None
    grades: Mapping[Grade, int]  # Queries by the grade of their first hypothesis
    intervals: Mapping[str, Interval]  # 95 % bootstrap intervals, by the metric's name in JSON
    reliability: tuple[ReliabilityBin, ...]
