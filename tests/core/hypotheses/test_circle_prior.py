"""A circle weights hypotheses by their positions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import (
    CirclePrior,
    apply_circle_prior,
    apply_path_prior_to_answer,
    fit_path_prior,
    photo_weights,
)

COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)
PATHS = fit_path_prior(np.column_stack([np.arange(0.0, 2000.0, 10.0), np.zeros(200)]), place_radius_px=20.0)


def place(x, p, *, y=0.0, radius=10.0):
    return Hypothesis(1, "position", MapPixel(x, y), p, radius, 0.0, (int(x),), 30, 40)


def answer(*places):
    return Answer(tuple(places), 1.0 - sum(p.probability for p in places), 0.0, None, COUNTS)


def test_a_place_in_the_circle_comes_before_one_outside():
    weighed = apply_circle_prior(
        answer(place(900, 0.6), place(100, 0.2)), CirclePrior(110, 5, 60), paths=PATHS
    )
    assert [h.position.x for h in weighed.hypotheses] == [100, 900]
    assert [h.rank for h in weighed.hypotheses] == [1, 2]
    assert weighed.hypotheses[0].probability > 0.8


def test_a_right_circle_makes_surer_and_a_smaller_one_surer_still():
    alone = answer(place(100, 0.3))
    wide, narrow = (
        apply_circle_prior(alone, CirclePrior(100, 0, r), paths=PATHS).hypotheses[0].probability
        for r in (300, 30)
    )
    assert 0.3 < wide < narrow


def test_a_circle_around_the_whole_map_says_next_to_nothing():
    weighed = apply_circle_prior(answer(place(100, 0.5)), CirclePrior(1000, 0, 5000), paths=PATHS)
    assert weighed.hypotheses[0].probability == pytest.approx(0.5, abs=0.01)


def test_a_wrong_circle_does_not_make_a_confident_wrong_answer():
    sure = answer(place(900, 0.97), place(100, 0.001))
    weighed = apply_circle_prior(sure, CirclePrior(100, 0, 40), paths=PATHS)
    assert weighed.hypotheses[0].position.x == 900
    assert all(h.probability < 0.5 for h in weighed.hypotheses if h.position.x == 100)
    assert weighed.off_map_probability > sure.off_map_probability


def test_a_photo_from_elsewhere_stays_elsewhere():
    weighed = apply_circle_prior(
        answer(place(100, 0.01), place(900, 0.02)), CirclePrior(100, 0, 60), paths=PATHS
    )
    assert weighed.abstained and weighed.hypotheses[0].probability < 0.3


def test_no_hypothesis_stays_none():
    nothing = Answer((), 1.0, 0.0, NoPose("no keypoints"), COUNTS)
    assert apply_circle_prior(nothing, CirclePrior(0, 0, 10), paths=PATHS) is nothing


def test_a_small_circle_draws_the_position_to_it():
    near = CirclePrior(90, 0, 10)
    alone, hinted = (
        apply_path_prior_to_answer(answer(place(110, 0.9, radius=20.0)), PATHS, weight=w)
        .hypotheses[0]
        .position.x
        for w in (None, photo_weights(near, PATHS))
    )
    assert alone == pytest.approx(110, abs=0.5)
    assert 92 < hinted < 108


@given(
    st.lists(st.tuples(st.floats(-100, 2100), st.floats(0.01, 1)), min_size=1, max_size=6),
    st.tuples(st.floats(-500, 2500), st.floats(-500, 500), st.floats(0.1, 1000)),
)
def test_it_adds_up_to_one(places, circle):
    total = sum(p for _, p in places) + 0.5
    hypotheses = tuple(place(x, p / total) for x, p in places)
    alone = Answer(hypotheses, 0.3 / total, 0.2 / total, None, COUNTS)
    weighed = apply_circle_prior(alone, CirclePrior(*circle), paths=PATHS)
    listed = [h.probability for h in weighed.hypotheses]
    assert sum(listed) + weighed.off_map_probability + weighed.other_probability == pytest.approx(1.0)
    assert listed == sorted(listed, reverse=True)
