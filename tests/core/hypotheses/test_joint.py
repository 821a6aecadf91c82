"""Several photos of one spot give one answer, whose probabilities add up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.joint import combine, most_confident
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import fit_path_prior

PATHS = fit_path_prior(np.column_stack([np.arange(0.0, 2000.0, 5.0), np.zeros(400)]), place_radius_px=10.0)
COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)


def place(x, probability, *, radius=2.0, kind="position", photos=(1,)):
    return Hypothesis(1, kind, MapPixel(x, 0.0), probability, radius, 90.0, photos, 30, 40)


def answer(*places, off=0.0):
    other = 1.0 - off - sum(p.probability for p in places)
    return Answer(tuple(places), off, other, None, COUNTS, seconds={"total": 1.0})


def test_a_place_that_both_name_rises_above_those_that_one_names():
    one = answer(place(0, 0.5), place(100, 0.4), off=0.1)
    two = answer(place(200, 0.5), place(1, 0.4), off=0.1)
    joint = combine([one, two], paths=PATHS, top=5)
    first, *others = joint.hypotheses
    assert 0 < first.position.x < 1 and first.probability > 0.8
    assert all(h.probability < 0.1 for h in others)
    assert [h.rank for h in joint.hypotheses] == [1, 2, 3]
    assert joint.off_map_probability < 0.1
    assert most_confident([one, two], joint.hypotheses) == 0


def test_two_weak_opinions_that_agree_are_more_than_one_and_less_than_two():
    weak = answer(place(0, 0.2), off=0.8)
    both = combine([weak, weak], paths=PATHS, top=5).hypotheses[0].probability
    assert 0.3 < both < 0.8


def test_photos_that_say_nothing_leave_a_sure_one_sure():
    sure, nothing = answer(place(0, 0.98), off=0.02), answer(place(500, 0.05), off=0.95)
    joint = combine([nothing, sure, nothing], paths=PATHS, top=5)
    assert joint.hypotheses[0].position.x == pytest.approx(0.0)
    assert 0.9 < joint.hypotheses[0].probability < 0.98
    assert most_confident([nothing, sure, nothing], joint.hypotheses) == 1


def test_a_dark_photo_changes_nothing():
    seen, dark = answer(place(0, 0.7), place(500, 0.1), off=0.2), answer(off=1.0)
    joint = combine([dark, seen, dark], paths=PATHS, top=5)
    assert [h.probability for h in joint.hypotheses] == pytest.approx([0.7, 0.1])
    assert joint.off_map_probability == pytest.approx(0.2)


def test_photos_from_elsewhere_stay_elsewhere():
    rng = np.random.default_rng(0)
    for _ in range(20):
        answers = [answer(place(float(rng.uniform(0, 2000)), 0.07), off=0.93) for _ in range(5)]
        joint = combine(answers, paths=PATHS, top=5)
        assert joint.hypotheses[0].probability < 0.5


def test_photos_that_are_sure_of_different_places_make_doubt():
    joint = combine(
        [answer(place(0, 0.95), off=0.05), answer(place(500, 0.95), off=0.05)], paths=PATHS, top=5
    )
    assert all(0.4 < h.probability < 0.5 for h in joint.hypotheses)


def test_precise_positions_count_more():
    one, two = answer(place(0, 0.9, radius=1.0), off=0.1), answer(place(4, 0.9, radius=8.0), off=0.1)
    assert 0 < combine([one, two], paths=PATHS, top=5).hypotheses[0].position.x < 1.0


def test_one_photo_is_answered_as_ever():
    alone = answer(place(0, 0.9))
    assert combine([alone], paths=PATHS, top=5) is alone


def test_no_hypothesis_at_all_stays_one():
    joint = combine([answer(off=1.0), answer(off=1.0)], paths=PATHS, top=5)
    assert joint.abstained and joint.off_map_probability == 1.0


def test_counts_are_summed():
    joint = combine([answer(place(0, 1.0)), answer(place(0, 1.0))], paths=PATHS, top=1)
    assert joint.statistics == MatchStatistics(20, 10, 8, 1.0, 9.0, 4.0, 40.0)
    assert joint.seconds == {"total": 2.0}


@given(
    st.lists(
        st.lists(st.tuples(st.floats(0, 500), st.floats(0.01, 1)), min_size=1, max_size=5),
        min_size=1,
        max_size=4,
    ),
    st.integers(1, 6),
)
def test_it_adds_up_to_one(photos, top):
    answers = []
    for places in photos:
        total = sum(p for _, p in places) + 0.5
        answers.append(answer(*(place(x, p / total) for x, p in places), off=0.25 / total))
    joint = combine(answers, paths=PATHS, top=max(top, 5 if len(answers) == 1 else top))
    listed = [h.probability for h in joint.hypotheses]
    assert sum(listed) + joint.other_probability + joint.off_map_probability == pytest.approx(1.0)
    if len(answers) > 1:
        assert listed == sorted(listed, reverse=True) and len(listed) <= top
