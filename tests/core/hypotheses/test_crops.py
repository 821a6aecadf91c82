"""The average of an answer over the fields of view that a photo may have."""

import math

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.crops import average_answers
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.tuning import CropsTuning

NONE = MatchStatistics(0, 0, 0, None, None, None, None)


def answer(off, *places, radius_px=10.0):
    """Build an answer from places (x, probability)."""
    hypotheses = tuple(
        Hypothesis(rank, "position", MapPixel(x, 0.0), p, radius_px, None, (rank,), 20, 40)
        for rank, (x, p) in enumerate(places, 1)
    )
    other = 1.0 - off - sum(p for _, p in places)
    return Answer(hypotheses, off, other, None, NONE, seconds={"verify": 1.0})


def averaged(*answers, **tuning):
    return average_answers(answers, tuning=CropsTuning(**tuning), place_radius_px=50.0)


def test_the_field_of_view_with_more_odds_counts_more():
    crop = averaged(answer(0.01, (0, 0.98)), answer(0.002, (300, 0.99)), answer(0.01, (600, 0.98)))
    assert [h.position[0] for h in crop.hypotheses] == pytest.approx([300, 0, 600])
    assert crop.hypotheses[0].probability > 0.8
    whole = averaged(answer(0.001, (0, 0.99)), answer(0.01, (300, 0.98)), answer(0.01, (600, 0.98)))
    assert whole.hypotheses[0].position[0] == pytest.approx(0.0)
    assert whole.hypotheses[0].probability > 0.95


def test_probabilities_add_up_and_times_are_added():
    mean = averaged(
        answer(0.01, (0, 0.9), (400, 0.05)), answer(0.1, (90, 0.7)), answer(0.4, (30, 0.5)), min_odds=9
    )
    total = sum(h.probability for h in mean.hypotheses) + mean.off_map_probability + mean.other_probability
    assert total == pytest.approx(1.0)
    assert mean.seconds == {"verify": 3.0}
    assert [h.rank for h in mean.hypotheses] == [1, 2, 3]


def test_the_scatter_of_a_place_is_in_its_radius():
    mean = averaged(answer(0.005, (0, 0.99)), answer(0.005, (40, 0.99)), prior=0.5)
    (place,) = mean.hypotheses
    assert place.position[0] == pytest.approx(20.0)
    assert place.radius_px == pytest.approx(math.hypot(10.0, 20.0))
    assert place.probability == pytest.approx(0.99)


def test_weak_answers_are_those_for_the_whole_photo():
    mean = averaged(answer(0.3, (0, 0.7)), answer(0.05, (300, 0.95)))
    assert [h.position[0] for h in mean.hypotheses] == [0.0]
    assert mean.off_map_probability == 0.3


def test_no_place_with_any_field_of_view():
    assert averaged(answer(1.0), answer(1.0), min_odds=0.0).hypotheses == ()


def test_areas_have_no_radius():
    area = answer(0.001, (0, 0.99), radius_px=None)
    assert averaged(area, area).hypotheses[0].radius_px is None
    assert np.isclose(averaged(area, area).hypotheses[0].probability, 0.99)
