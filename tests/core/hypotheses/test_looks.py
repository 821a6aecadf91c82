"""Two looks at one photo give one answer, each weighted by its certainty."""

import math
from dataclasses import replace

import pytest

from tests.core.hypotheses.test_joint import answer, place
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.calibration import Calibration
from webapp.core.hypotheses.jsonform import answer_from_json, answer_to_json
from webapp.core.hypotheses.looks import DEFAULT, combine_looks, evidence_of_looks, is_certain
from webapp.core.hypotheses.model import AnswerSource
from webapp.core.hypotheses.verdict import verdict_of

EQUAL = Calibration(slope=(1.0, 1.0), offset=-5.5, radius_scale=1.0)


def combine(*answers, calibration=EQUAL):
    return combine_looks(answers, calibration=calibration, place_radius_px=10.0, top=5)


def total(joint):
    return sum(h.probability for h in joint.hypotheses) + joint.other_probability + joint.off_map_probability


def test_a_place_that_both_looks_name_is_surer_than_by_either():
    one, two = (
        answer(place(0, 0.6), place(100, 0.3), off=0.1),
        answer(place(3, 0.5), place(300, 0.3), off=0.2),
    )
    joint = combine(one, two)
    assert 0 < joint.hypotheses[0].position.x < 3
    assert joint.hypotheses[0].probability > 0.6
    assert total(joint) == pytest.approx(1.0)


def test_a_look_that_knows_nothing_leaves_the_other_its_place():
    dark, sure = answer(place(500, 0.02), off=0.98), answer(place(0, 0.95), off=0.01)
    joint = combine(dark, sure)
    assert joint.hypotheses[0].position.x == pytest.approx(0.0)
    assert joint.hypotheses[0].probability > 0.8


def test_where_neither_knows_the_photo_is_not_on_the_map():
    one, two = answer(place(0, 0.1), off=0.9), answer(place(300, 0.1), off=0.9)
    joint = combine(one, two)
    assert joint.abstained
    assert joint.off_map_probability > 0.7


def test_no_hypotheses_at_all_is_not_on_the_map_either():
    joint = combine(answer(off=1.0), answer(off=1.0))
    assert (joint.hypotheses, joint.off_map_probability) == ((), 1.0)


def test_a_steeper_slope_makes_a_look_count_more():
    one, two = answer(place(0, 0.7), off=0.3), answer(place(300, 0.7), off=0.3)
    first = combine(one, two, calibration=Calibration(slope=(2.0, 0.5), offset=-5.5, radius_scale=1.0))
    assert [h.position.x for h in first.hypotheses] == [0.0, 300.0]


def test_many_places_with_hardly_any_evidence_do_not_add_up_to_the_map():
    one = answer(*(place(100 * n, 0.015) for n in range(10)), off=0.85)
    two = answer(*(place(100 * n + 50, 0.015) for n in range(10)), off=0.85)
    joint = combine(one, two, calibration=DEFAULT)
    assert joint.off_map_probability > 0.9
    assert total(joint) == pytest.approx(1.0)


def test_weak_evidence_keeps_its_order():
    one = answer(place(0, 0.002), place(100, 0.02), place(200, 0.0001), off=0.97)
    joint = combine(one, answer(off=1.0), calibration=DEFAULT)
    assert [h.position.x for h in joint.hypotheses] == pytest.approx([100.0, 0.0, 200.0])
    best, next_one, _ = joint.hypotheses
    assert best.probability > 2 * next_one.probability


def test_evidence_is_the_logarithm_of_the_odds_above_a_trace():
    places, evidence = evidence_of_looks([[place(0, 0.6)], [place(4, 0.2)]], [0.2, 0.8], radius_px=10.0)
    assert len(places) == 1
    assert evidence[0].tolist() == pytest.approx([math.log(101.0), math.log(1.0 + 0.25 / 0.03)])


def test_certainty_and_impossibility_stay_finite():
    joint = combine(answer(place(0, 1.0), place(90, 0.0), off=0.0), answer(place(0, 1.0), off=0.0))
    assert joint.hypotheses[0].probability > 0.999
    assert len(joint.hypotheses) == 1


def test_a_sure_answer_needs_no_further_look():
    assert is_certain(answer(place(0, 0.95), off=0.05))
    assert not is_certain(answer(place(0, 0.6), place(100, 0.4)))
    assert not is_certain(answer(off=1.0))


def test_a_look_that_hardly_believes_in_its_position_does_not_move_the_answer():
    sure, faint = answer(place(0, 0.85, kind="photo"), off=0.15), answer(place(9, 0.001), off=0.999)
    first = combine(sure, faint).hypotheses[0]
    assert (first.kind, first.position.x) == ("photo", 0.0)


def test_a_computed_position_goes_before_a_photo_of_about_the_same_probability():
    photo, computed = (
        answer(place(0, 0.6, kind="photo"), off=0.4),
        answer(place(6, 0.5, photos=(2,)), off=0.5),
    )
    first = combine(photo, computed).hypotheses[0]
    assert (first.kind, first.position.x) == ("position", pytest.approx(6.0))
    assert first.experiences == (1, 2)


BLANK = replace(answer(off=1.0), off_map_probability=None, no_pose=NoPose("nothing to see", blank=True))


def test_a_blank_look_leaves_the_answer_to_the_other():
    joint = combine(BLANK, answer(place(0, 0.9), off=0.05))
    assert joint.hypotheses[0].position.x == pytest.approx(0.0)
    assert verdict_of(joint) == "place"
    elsewhere = combine(BLANK, replace(answer(off=1.0), no_pose=NoPose("no match")))
    assert (verdict_of(elsewhere), elsewhere.off_map_probability) == ("off_map", 1.0)


def test_nothing_to_see_is_no_place_and_not_off_the_map():
    joint = combine(BLANK, BLANK)
    assert not joint.no_pose and joint.off_map_probability is None
    assert verdict_of(joint) == "nothing_to_see"
    form = answer_to_json(joint, query="q.jpg", source=AnswerSource("auto", "sift", None, 1))
    assert (form["verdict"], form["no_pose"], form["hypotheses"]) == ("nothing_to_see", "nothing to see", [])
    assert form["sentence"].startswith("Nothing to recognise")
    assert verdict_of(answer_from_json(form)) == "nothing_to_see"
