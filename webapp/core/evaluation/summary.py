"""All metrics of an evaluation at once, and one row per query as field experiments report it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.evaluation import metrics
from webapp.core.evaluation.metrics import grade
from webapp.core.evaluation.types import Grade, Interval, QueryResult, Summary
from webapp.core.hypotheses.model import MatchStatistics

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
    """Convert the results to arrays."""
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
        return lambda o: metrics.share_within(o.errors, radius)

    def stated(o: Outcomes) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        has = np.isfinite(o.probabilities)  # not by errors, which are infinite on a wrong floor
        return o.probabilities[has], o.errors[has] <= place_radius_px

    return {
        "median_px": lambda o: metrics.median_error(o.errors),
        "mean_px": lambda o: metrics.mean_error(o.errors),
        **{f"within_{radius}px": within(radius) for radius in WITHIN_PX},
        "top5_within_50px": lambda o: metrics.share_within(o.best_of_top, 50),
        "ece": lambda o: metrics.expected_calibration_error(*stated(o)),
        "radius_coverage": lambda o: metrics.radius_coverage(
            o.errors, o.radii, place_radius_px=place_radius_px
        ),
        "answered_at_99_precision": lambda o: metrics.answered_at_precision(
            *stated(o), queries=o.errors.size
        ),
    }


def summarise(results: Sequence[QueryResult], *, place_radius_px: float, rng: np.random.Generator) -> Summary:
    """Compute all metrics of an evaluation.

    Args:
        results: At least one.
        place_radius_px: Largest error at which a hypothesis is right, map pixels.
        rng: For the bootstrap.
    """
    found = outcomes(results)
    recipes = figures(place_radius_px)
    values = {name: figure(found) for name, figure in recipes.items()}
    has = np.isfinite(found.probabilities)
    grades = Counter(metrics.grade(float(error), place_radius_px) for error in found.errors)
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
        grades={word: grades[word] for word, _ in metrics.GRADES},
        intervals=_intervals(found, recipes, rng),
        reliability=metrics.reliability_bins(found.probabilities[has], found.errors[has] <= place_radius_px),
    )


def _intervals(
    found: Outcomes, recipes: dict[str, Callable[[Outcomes], float | None]], rng: np.random.Generator
) -> dict[str, Interval]:
    intervals = {}
    for name, figure in recipes.items():
        interval = metrics.bootstrap_interval(_of_sample(found, figure), found.errors.size, rng=rng)
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
