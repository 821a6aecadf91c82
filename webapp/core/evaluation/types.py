"""Data of an evaluation: one result per query, and the metrics over all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer

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
