"""One row per query, as field experiments report it: counts, distances, seconds, grades and errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from webapp.core.evaluation.metrics import grade
from webapp.core.evaluation.types import Grade, QueryResult
from webapp.core.hypotheses.model import MatchStatistics


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
