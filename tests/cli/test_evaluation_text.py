from pathlib import Path

import numpy as np
import pytest

from webapp.cli.evaluate import summary_table
from webapp.core.evaluation.metrics import QueryResult, summarise
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Map, SatelliteImage
from webapp.tasks.evaluation.types import Evaluation, Scheme, Subject


def an_evaluation(scheme: Scheme = "queries", hide_within_px: float | None = None) -> Evaluation:
    results = (QueryResult("a.jpg", MapPixel(0, 0), None, "broken"),) * 3
    subject = Subject(
        Path(),
        "vote",
        "orb",
        Map(SatelliteImage("p.png", 9, 9), ()),
        "",
        20.0,
        "metric",
        2.5,
        None,
        1_000_000,
    )
    summary = summarise(results, place_radius_px=20, rng=np.random.default_rng(0))
    return Evaluation(subject, scheme, hide_within_px, Path(), results, summary, 0, 12.0, {})


def test_table_is_aligned_and_has_a_dash_for_the_unknown() -> None:
    lines = summary_table(an_evaluation()).splitlines()
    assert lines[0] == "vote, orb: map of 0 photos, 3 queries"
    median = next(line for line in lines if line.startswith("median error"))
    assert median.split() == ["median", "error", "–"]
    within = next(line for line in lines if line.startswith("within 20 px"))
    assert within.split()[3:5] == ["0.0", "%"]
    assert within.index("0.0 %") + 5 == len(median)


@pytest.mark.parametrize(
    ("scheme", "within", "words"),
    [("leave-one-out", None, "each hidden"), ("leave-one-place-out", 35.0, "within 35 px hidden")],
)
def test_heading_says_what_was_hidden(scheme: Scheme, within: float | None, words: str) -> None:
    assert words in summary_table(an_evaluation(scheme, within)).splitlines()[0]
