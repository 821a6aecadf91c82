"""The radius of right answers is fitted on both kinds of trials equally, whatever their numbers."""

import numpy as np
import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import DEFAULT, EVIDENCE
from webapp.core.localize.places import LocatedPlace, PlaceCandidate
from webapp.tasks.localize.calibrate import _radius_scale
from webapp.tasks.localize.trials import Trial

PLACE_RADIUS = 20.0
SIGMA = 5.0


def scale(**ratios):
    """Fit on trials with errors given in sigmas; `photo=[...], place=[...]`."""
    trials, located, errors = [], [], []
    for hidden, there in ratios.items():
        for ratio in there:
            at = MapPixel(ratio * SIGMA, 0.0)
            place = PlaceCandidate("position", at, None, SIGMA, [], 1.0, at)
            trials.append(Trial(np.ones((1, EVIDENCE)), [place], (0.0, 0.0), hidden, True, 0.0))
            located.append([LocatedPlace("position", at, SIGMA, None)])
            errors.append(np.array([ratio * SIGMA]))
    return _radius_scale(trials, located, errors=errors, place_radius_px=PLACE_RADIUS)


def spread(largest, count):
    return [*np.linspace(0.0, largest, count)]


def test_of_one_kind_it_is_their_quantile():
    assert scale(photo=spread(2.5, 101)) == pytest.approx(0.68 * 2.5, abs=0.02)
    assert scale(place=spread(3.0, 41)) == pytest.approx(0.68 * 3.0, abs=0.05)


def test_many_that_were_hidden_alone_do_not_outvote_those_hidden_with_their_neighbours():
    few, many = (scale(photo=spread(1.2, n), place=spread(3.2, 25)) for n in (25, 200))
    assert many == pytest.approx(few, abs=0.05)
    # below x = 1.2, the two kinds together have the weight 0.5 * x / 1.2 + 0.5 * x / 3.2
    assert few == pytest.approx(0.68 / (0.5 / 1.2 + 0.5 / 3.2), abs=0.06)


def test_one_trial_of_a_kind_does_not_decide():
    alone = scale(photo=spread(2.0, 30))
    assert scale(photo=spread(2.0, 30), place=[3.9]) == pytest.approx(alone, abs=0.2)


def test_too_few_keep_the_default_and_it_never_shrinks():
    assert scale(photo=[3.0] * 5, place=[3.0] * 4) == DEFAULT.radius_scale
    assert scale(photo=spread(0.5, 100), place=spread(0.5, 20)) == 1.0


def test_trials_from_elsewhere_and_wrong_answers_do_not_count():
    without = scale(photo=spread(2.0, 50))
    assert scale(photo=spread(2.0, 50), surroundings=[3.9] * 50) == without
    assert scale(photo=spread(2.0, 50), place=[5.0] * 50) == without
