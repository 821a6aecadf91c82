"""An answer with a guessed focal length is averaged with that of a cropped photo."""

from dataclasses import replace

import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.focal_lengths import average, narrower
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics

NONE = MatchStatistics(0, 0, 0, None, None, None, None)
RADIUS = 50.0


def place(x, probability, *photos, kind="position"):
    return Hypothesis(1, kind, MapPixel(x, 0.0), probability, 10.0, None, photos, 40, 60)


def answer(*places):
    total = sum(p.probability for p in places)
    return Answer(places, 1.0 - total, 0.0, None, NONE)


CROPPED = 0.06


def averaged(whole, cropped):
    joined = average(whole, [cropped, cropped], place_radius_px=RADIUS)
    total = sum(h.probability for h in joined.hypotheses) + joined.off_map_probability
    assert total == pytest.approx(1.0)
    return joined


def test_what_both_say_stays():
    one = answer(place(100, 0.8, 3, 4), place(900, 0.1, 7))
    assert averaged(one, one).hypotheses == (
        replace(one.hypotheses[0], probability=pytest.approx(0.8)),
        replace(one.hypotheses[1], probability=pytest.approx(0.1), rank=2),
    )


def test_two_places_of_equal_evidence_are_both_less_probable():
    joined = averaged(answer(place(100, 0.9, 3)), answer(place(220, 0.9, 3)))
    first, second = joined.hypotheses
    assert (first.position.x, second.position.x) == (100, 220)
    assert first.probability == pytest.approx(0.9 * (1 - CROPPED))
    assert second.probability == pytest.approx(0.9 * CROPPED)


def test_the_focal_length_with_more_evidence_wins():
    joined = averaged(answer(place(100, 0.8, 3)), answer(place(220, 0.99, 3)))
    assert joined.hypotheses[0].position.x == 220
    assert joined.hypotheses[0].probability > 0.5


def test_near_estimates_from_the_same_photos_are_one_place_whose_radius_contains_both():
    (one,) = averaged(answer(place(100, 0.9, 3)), answer(place(140, 0.9, 3, 5))).hypotheses
    assert one.probability == pytest.approx(0.9)
    assert one.position.x == 100
    assert one.radius_px == pytest.approx((100 + 1600 * CROPPED) ** 0.5)
    assert len(averaged(answer(place(100, 0.9, 3)), answer(place(140, 0.9, 8))).hypotheses) == 2


def test_a_cropped_photo_shows_half_the_width():
    assert narrower(90.0)[-1] == pytest.approx(53.13, abs=0.01)
