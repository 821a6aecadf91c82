"""A compass heading weights hypotheses by their headings."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import apply_compass

COUNTS = MatchStatistics(10, 5, 4, 1.0, 9.0, 4.0, 20.0)


def place(rank, probability, heading):
    kind = "photo" if heading is None else "position"
    return Hypothesis(rank, kind, MapPixel(100.0 * rank, 0.0), probability, 5.0, heading, (rank,), 30, 40)


def answer(*places):
    return Answer(tuple(places), 1.0 - sum(p.probability for p in places), 0.0, None, COUNTS)


def test_the_one_that_looks_that_way_comes_first():
    weighed = apply_compass(answer(place(1, 0.5, 180.0), place(2, 0.4, 355.0)), 5.0)
    assert [h.experiences for h in weighed.hypotheses] == [(2,), (1,)]
    assert [h.rank for h in weighed.hypotheses] == [1, 2]
    assert weighed.hypotheses[0].probability > 0.9
    total = sum(h.probability for h in weighed.hypotheses) + weighed.off_map_probability
    assert total == pytest.approx(1.0)


def test_disagreement_makes_off_the_map_more_probable():
    alone = answer(place(1, 0.8, 180.0))
    assert apply_compass(alone, 0.0).off_map_probability > 2 * alone.off_map_probability
    assert apply_compass(alone, 180.0).off_map_probability < alone.off_map_probability


def test_a_compass_can_be_wrong():
    assert apply_compass(answer(place(1, 0.99, 180.0)), 0.0).hypotheses[0].probability > 0.85


def test_no_heading_no_opinion():
    alone = answer(place(1, 0.6, None))
    assert apply_compass(alone, 77.0).hypotheses[0].probability == pytest.approx(0.6)


def test_a_photo_that_is_all_that_is_known_looks_about_where_the_query_does():
    alone = answer(place(1, 0.4, None), place(2, 0.4, None))
    weighed = apply_compass(alone, 90.0, looked_deg={1: 270.0, 2: 80.0})
    assert [h.experiences for h in weighed.hypotheses] == [(2,), (1,)]
    assert (
        weighed.hypotheses[0].probability
        < apply_compass(answer(place(1, 0.4, 270.0), place(2, 0.4, 80.0)), 90.0).hypotheses[0].probability
    )


@given(st.lists(st.tuples(st.floats(0.01, 1), st.floats(0, 360)), min_size=1, max_size=5), st.floats(0, 360))
def test_it_adds_up_to_one(places, heading):
    total = sum(p for p, _ in places) + 0.5
    hypotheses = [place(n, p / total, deg) for n, (p, deg) in enumerate(places, 1)]
    alone = Answer(tuple(hypotheses), 0.3 / total, 0.2 / total, None, COUNTS)
    weighed = apply_compass(alone, heading)
    listed = [h.probability for h in weighed.hypotheses]
    assert sum(listed) + weighed.off_map_probability + weighed.other_probability == pytest.approx(1.0)
    assert weighed.other_probability / weighed.off_map_probability == pytest.approx(2 / 3)
    assert listed == sorted(listed, reverse=True)
