"""Georeference from control points, against a synthetic truth."""

import numpy as np
import pytest

from webapp.core.geo.fit import NEEDED, ControlPoint, from_control_points
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError

PLANE = LocalFrame(LatLon(50.0, 14.4)).plane
SIZE = {"width": 2000, "height": 1500}
TRUTH = {
    "similarity": (0.2, 0.1, -150.0, 0.1, -0.2, 90.0, 0.0, 0.0, 1.0),
    "affine": (0.2, 0.05, -150.0, 0.02, -0.25, 90.0, 0.0, 0.0, 1.0),
    "projective": (0.2, 0.05, -150.0, 0.02, -0.25, 90.0, 1e-5, 5e-5, 1.0),
}
PIXELS = np.array(
    [(100, 100), (1900, 150), (1800, 1400), (150, 1350), (900, 700), (400, 1000), (1500, 300), (700, 200)],
    dtype=float,
)


def points(model, count, *, noise_m=0.0):
    truth = Georeference(PLANE, TRUTH[model], model)
    frame = LocalFrame(LatLon(50.0, 14.4))
    enu = truth.enu_from_pixel(PIXELS[:count], frame)
    enu = enu + np.random.default_rng(7).normal(0, noise_m, enu.shape)
    latlon = frame.latlon_from_enu(enu)
    return [
        ControlPoint(MapPixel(*p), LatLon(*q)) for p, q in zip(PIXELS.tolist(), latlon.tolist(), strict=False)
    ]


def off_m(fit, model):
    """Return the largest error over the image, metres."""
    grid = np.stack(np.meshgrid(np.linspace(0, 2000, 9), np.linspace(0, 1500, 7)), -1).reshape(-1, 2)
    frame = LocalFrame(LatLon(50.0, 14.4))
    truth = Georeference(PLANE, TRUTH[model], model).enu_from_pixel(grid, frame)
    return np.hypot(*(fit.georeference.enu_from_pixel(grid, frame) - truth).T).max()


@pytest.mark.parametrize("extra", [0, 3])
@pytest.mark.parametrize("model", list(NEEDED))
def test_exact_points_give_the_truth_to_a_millimetre(model, extra):
    fit = from_control_points(points(model, NEEDED[model] + extra), **SIZE, model=model)
    assert off_m(fit, model) < 1e-3
    assert max(fit.residuals_m) < 1e-4
    assert len(fit.residuals_m) == NEEDED[model] + extra
    assert fit.georeference.method == model
    assert bool(fit.warnings) == (extra == 0)


@pytest.mark.parametrize(
    ("count", "model"), [(2, "similarity"), (3, "affine"), (4, "projective"), (8, "projective")]
)
def test_the_richest_model_is_the_default(count, model):
    assert from_control_points(points(model, count), **SIZE).georeference.method == model


@pytest.mark.parametrize("model", list(NEEDED))
def test_noise_shows_in_the_residuals(model):
    fit = from_control_points(points(model, 8, noise_m=0.5), **SIZE, model=model)
    assert 0.1 < np.sqrt(np.mean(np.square(fit.residuals_m))) < 1.5
    assert off_m(fit, model) < 3.0
    assert fit.warnings == ()


def test_a_wrong_point_has_the_largest_residual():
    known = points("affine", 8)
    known[5] = known[5]._replace(position=LatLon(known[5].position.lat + 3e-4, known[5].position.lon))
    residuals = from_control_points(known, **SIZE, model="affine").residuals_m
    assert np.argmax(residuals) == 5
    assert residuals[5] > 10


def test_least_squares_are_those_of_numpy():
    known = points("affine", 8, noise_m=1.0)
    frame = LocalFrame(LatLon(50.0, 14.4))
    enu = frame.enu_from_latlon([p.position for p in known])
    design = np.column_stack([PIXELS, np.ones(8)])
    wanted = design @ np.linalg.lstsq(design, enu, rcond=None)[0]
    fit = from_control_points(known, **SIZE, model="affine")
    assert fit.georeference.enu_from_pixel(PIXELS, frame) == pytest.approx(wanted, abs=1e-3)


def test_nearly_collinear_points_are_warned_about():
    truth = Georeference(PLANE, TRUTH["affine"], "affine")
    near = [(0, 0), (500, 510), (1000, 1000), (1500, 1490)]
    known = [ControlPoint(MapPixel(*p), truth.latlon_of(MapPixel(*p))) for p in near]
    fit = from_control_points(known, **SIZE, model="affine")
    assert "singular value ratio" in fit.warnings[0]
    assert max(fit.residuals_m) < 1e-3


@pytest.mark.parametrize(
    ("pixels", "model", "part"),
    [
        ([(0, 0)], None, "at least 2"),
        ([(0, 0), (10, 10)], "affine", "needs 3"),
        ([(0, 0), (0, 0)], None, "same pixel"),
        ([(0, 0), (500, 500), (1000, 1000)], None, "one line"),
        ([(0, 0), (500, 500), (1000, 1000), (0, 1000)], None, "do not determine"),
        ([(0, 0), (float("nan"), 5)], None, "finite"),
    ],
)
def test_what_determines_nothing_is_refused(pixels, model, part):
    truth = Georeference(PLANE, TRUTH["affine"], "affine")
    known = [ControlPoint(MapPixel(*p), truth.latlon_of(MapPixel(*np.nan_to_num(p)))) for p in pixels]
    with pytest.raises(GeoreferenceError, match=part):
        from_control_points(known, **SIZE, model=model)


def test_two_points_at_one_place_are_refused():
    known = [ControlPoint(MapPixel(0, 0), LatLon(50, 14)), ControlPoint(MapPixel(100, 0), LatLon(50, 14))]
    with pytest.raises(GeoreferenceError, match="points 1 and 2 have the same position"):
        from_control_points(known, **SIZE)


@pytest.mark.parametrize("model", ["affine", "projective"])
def test_a_mirrored_image_is_refused(model):
    mirrored = [p._replace(pixel=MapPixel(2000 - p.pixel.x, p.pixel.y)) for p in points("affine", 8)]
    with pytest.raises(GeoreferenceError, match="mirrored"):
        from_control_points(mirrored, **SIZE, model=model)


def test_a_horizon_across_the_image_is_refused():
    truth = Georeference(PLANE, (0.2, 0.0, 0.0, 0.0, -0.2, 0.0, 0.0, -0.001, 1.0), "projective")
    near = [MapPixel(x, y) for x, y in ((0, 0), (500, 0), (500, 500), (0, 500))]
    known = [ControlPoint(p, truth.latlon_of(p)) for p in near]
    assert max(from_control_points(known, width=600, height=900).residuals_m) < 1e-3
    with pytest.raises(GeoreferenceError, match="horizon"):
        from_control_points(known, width=600, height=1200)


def test_points_around_the_180th_meridian():
    truth = Georeference(LocalFrame(LatLon(-17.0, 180.0)).plane, TRUTH["similarity"], "similarity")
    known = [ControlPoint(MapPixel(*p), truth.latlon_of(MapPixel(*p))) for p in PIXELS.tolist()]
    assert {p.position.lon > 0 for p in known} == {True, False}
    fit = from_control_points(known, **SIZE, model="similarity")
    assert max(fit.residuals_m) < 1e-3
