"""Several photos of one spot give one answer that adds up."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.joint import join, surest
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics

COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)


def place(x, probability, *, radius=2.0, kind="position", photos=(1,)):
    return Hypothesis(1, kind, MapPixel(x, 0.0), probability, radius, 90.0, photos, 30, 40)


def answer(*places, off=0.0):
    other = 1.0 - off - sum(p.probability for p in places)
    return Answer(tuple(places), off, other, None, COUNTS, seconds={"total": 1.0})


def test_a_place_that_both_name_rises_above_those_that_one_names():
    one = answer(place(0, 0.5), place(100, 0.4), off=0.1)
    two = answer(place(200, 0.5), place(1, 0.4), off=0.1)
    joint = join([one, two], place_radius_px=10, top=5)
    assert [round(h.probability, 3) for h in joint.hypotheses] == [0.45, 0.25, 0.2]
    assert 0 < joint.hypotheses[0].position.x < 1
    assert [h.rank for h in joint.hypotheses] == [1, 2, 3]
    assert joint.off_map_probability == pytest.approx(0.1)
    assert surest([one, two], joint) == 0


def test_precise_positions_count_more():
    joint = join(
        [answer(place(0, 0.9, radius=1.0)), answer(place(4, 0.9, radius=4.0))], place_radius_px=10, top=5
    )
    assert joint.hypotheses[0].position.x == pytest.approx(4 / 17)


def test_one_photo_is_answered_as_ever():
    alone = answer(place(0, 0.9))
    assert join([alone], place_radius_px=10, top=5) is alone


def test_no_hypothesis_at_all_stays_one():
    joint = join([answer(off=1.0), answer(off=1.0)], place_radius_px=10, top=5)
    assert joint.abstained and joint.off_map_probability == 1.0


def test_counts_are_summed():
    joint = join([answer(place(0, 1.0)), answer(place(0, 1.0))], place_radius_px=10, top=1)
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
    joint = join(answers, place_radius_px=20, top=max(top, 5 if len(answers) == 1 else top))
    listed = [h.probability for h in joint.hypotheses]
    assert sum(listed) + joint.other_probability + joint.off_map_probability == pytest.approx(1.0)
    if len(answers) > 1:
        assert listed == sorted(listed, reverse=True) and len(listed) <= top
