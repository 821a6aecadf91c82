"""When a localized photo counts as a fix, and with which accuracy."""

import math

import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.visual import visual_fix

PLANE = LocalFrame(LatLon(50.0, 14.0)).plane
EVEN = Georeference(PLANE, (0.5, 0, 0, 0, -0.5, 0, 0, 0, 1), "affine")
OBLONG = Georeference(PLANE, (1.0, 0, 0, 0, -0.25, 0, 0, 0, 1), "affine")


def answer(probability=0.9, *, off=0.05, **more):
    best = {"x_px": 0.0, "y_px": 0.0, "lat": 50.0, "lon": 14.0, "radius_px": 10.0, "heading_deg": 30.0}
    return {"hypotheses": [{**best, "probability": probability, **more}], "off_map_probability": off}


def test_the_circle_holds_two_thirds_of_what_the_covariance_says():
    fix = visual_fix(answer(), EVEN)
    east, north, both = fix.covariance_m2
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal([0, 0], [[east, both], [both, north]], size=20_000)
    assert (np.hypot(*drawn.T) < 5.0).mean() == pytest.approx(0.68, abs=0.01)
    assert fix.latlon == LatLon(50.0, 14.0)
    assert fix.heading_deg == 30.0


def test_pixels_that_are_no_squares():
    east, north, both = visual_fix(answer(), OBLONG).covariance_m2
    assert math.sqrt(east / north) == pytest.approx(4.0, rel=1e-3)
    assert both == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ({"hypotheses": [], "off_map_probability": 1.0}, "not taken on this map"),
        (answer(0.4, off=0.5), "not taken on this map"),
        (answer(0.6, off=0.1), "no place is clearly"),
        (answer(lat=None, lon=None), "no georeference"),
        (answer(radius_px=None), "accuracy"),
    ],
)
def test_what_is_not_a_fix_says_why(answer, why):
    fix = visual_fix(answer, EVEN)
    assert not fix
    assert why in fix.reason


def test_beyond_the_horizon_there_is_no_scale():
    horizon = Georeference(PLANE, (1, 0, 0, 0, -1, 0, 0, -0.1, 1), "projective")
    assert not visual_fix(answer(y_px=50.0), horizon)


def test_a_photo_with_nothing_to_recognise_says_so_and_not_that_it_is_elsewhere():
    blank = {"hypotheses": [], "off_map_probability": None, "verdict": "nothing_to_see"}
    found = visual_fix(blank, EVEN)
    assert not found and found.blank and found.reason == "the photo has nothing to recognise"
