import dataclasses

import numpy as np
import pytest

from webapp.core.evaluation.metrics import QueryResult, row, summarise
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics

STATISTICS = MatchStatistics(100, 80, 50, 0.1, 0.9, 0.4, 32.0)


def answered(
    *found: tuple[float, float],
    off: float | None = 0.05,
    radius: float | None = 10.0,
    looks: tuple[str, ...] = ("sift",),
) -> QueryResult:
    """Make a result from (distance to the truth, probability) of each hypothesis."""
    hypotheses = tuple(
        Hypothesis(rank, "photo", MapPixel(500 + d, 300), p, radius, None, (rank,), 20, 40)
        for rank, (d, p) in enumerate(found, 1)
    )
    seconds = {"extract": 0.1, "retrieve": 0.2, "verify": 0.3, "position": 0.05, "total": 0.7}
    no_pose = None if hypotheses else NoPose("no match")
    whole = Answer(hypotheses, off, 0.0, no_pose, STATISTICS, (), seconds, looks=looks)
    return QueryResult("q.jpg", MapPixel(500, 300), whole)


FAILED = QueryResult("broken.jpg", MapPixel(0, 0), None, "broken.jpg: not a photo")
RESULTS = [
    answered((5, 0.9), (200, 0.05)),
    answered((15, 0.8), looks=("sift", "xfeat")),
    answered((90, 0.3), (40, 0.2), off=0.5),
    answered((0, 0.4), radius=None),
    answered(off=1.0),
    FAILED,
]


def test_summary_by_hand() -> None:
    summary = summarise(RESULTS, place_radius_px=20, rng=np.random.default_rng(0))
    assert (summary.queries, summary.failed, summary.abstained) == (6, 1, 2)
    assert summary.second_looks == 1
    assert summary.median_px == 10.0
    assert summary.mean_px == pytest.approx(27.5)
    assert summary.within == pytest.approx({10: 2 / 6, 20: 3 / 6, 50: 3 / 6, 100: 4 / 6, 400: 4 / 6})
    assert summary.top5_within_50px == pytest.approx(4 / 6)
    assert summary.ece == pytest.approx((0.1 + 0.2 + 0.3 + 0.6) / 4)
    assert summary.radius_coverage == pytest.approx(0.5)
    assert summary.answered_at_99_precision == pytest.approx(3 / 6)
    assert summary.grades == {"excellent": 2, "good": 1, "sufficient": 0, "insufficient": 3}
    assert summary.seconds_per_query_p50 == pytest.approx(0.7)
    assert summary.extract_seconds_p50 == pytest.approx(0.1)
    assert summary.match_seconds_p50 == pytest.approx(0.55)
    low, high = summary.intervals["within_20px"]
    assert low < 0.5 < high


def test_summary_of_failures_only_says_what_it_does_not_know() -> None:
    summary = summarise([FAILED], place_radius_px=20, rng=np.random.default_rng(0))
    assert summary.median_px is None
    assert summary.ece is None
    assert summary.seconds_per_query_p50 is None
    assert summary.within[400] == 0.0
    assert "median_px" not in summary.intervals


def test_a_wrong_floor_is_a_wrong_answer_with_the_probability_that_it_said() -> None:
    right = dataclasses.replace(answered((5, 0.9)), truth_floor=0)
    wrong = dataclasses.replace(answered((5, 0.9)), truth_floor=1)
    summary = summarise([right, wrong], place_radius_px=20, rng=np.random.default_rng(0))
    assert summary.ece == pytest.approx(0.4)  # stated 0.9, of which half is right
    assert sum(b.count for b in summary.reliability) == 2
    assert summary.answered_at_99_precision == 0.0
    assert summary.median_px == 5.0


def test_only_the_first_five_hypotheses_count() -> None:
    sixth = answered(*[(100.0 + i, 0.1) for i in range(5)], (1.0, 0.1))
    assert summarise([sixth], place_radius_px=20, rng=np.random.default_rng(0)).top5_within_50px == 0.0


def test_row_grades_the_first_and_the_nearest_other() -> None:
    line = row(RESULTS[2], place_radius_px=40, metres_per_pixel=0.5)
    assert line.grade_first == "insufficient"
    assert line.grade_others == "good"
    assert (line.first_px, line.worst_px) == (90, 90)
    assert (line.first_m, line.worst_m) == (45, 45)
    assert line.statistics is STATISTICS
    assert line.seconds == 0.7


def test_row_of_a_failed_query_is_empty_but_graded() -> None:
    line = row(FAILED, place_radius_px=40, metres_per_pixel=None)
    assert (line.grade_first, line.grade_others, line.first_px, line.statistics) == (
        "insufficient",
        None,
        None,
        None,
    )
