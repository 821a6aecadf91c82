"""Control points clicked in photos lay a submodel on the map, alone or together with placed photos."""

from dataclasses import replace

import numpy as np
import pytest

from tests.core.landmarks.scene import known_at, submodel_of
from webapp.core.geometry import so3
from webapp.core.landmarks import control_points
from webapp.core.landmarks.control_points import KnownPoint, NotTriangulated, triangulate
from webapp.core.landmarks.georegister import georegister
from webapp.core.landmarks.placing import AlignedSubmodel, align_submodel, outlying_positions
from webapp.core.landmarks.submodels import Submodel, fit_similarity

SPOTS = {
    "gate": (150 + 180j, 3.0),
    "well": (860 + 240j, -8.0),
    "oak": (480 + 850j, 40.0),
    "stone": (300 + 600j, 5.0),
}
"""Map pixels, and pixels above the cameras."""


@pytest.fixture
def court(rng):
    """Map pixels and headings of 40 photos around a court."""
    return rng.uniform(100.0, 900.0, 40) + 1j * rng.uniform(100.0, 900.0, 40), rng.uniform(-3.0, 3.0, 40)


def clicked(submodel, at, name, photos, *, rng, sigma_rad=0.0, height=True):
    """Return a control point, clicked in some photos of a submodel whose cameras are at `at`."""
    spot, up = SPOTS[name]
    world = np.array([spot.real, -up, -spot.imag])
    cameras = np.stack([at.real, 0.0 * at.real, -at.imag], 1)
    there = fit_similarity(cameras, submodel.centre).apply(world[None])
    ray = np.einsum("rij,rj->ri", submodel.rotation[photos], there - submodel.centre[photos])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    off = so3.retract(np.tile(np.eye(3), (len(photos), 1, 1)), rng.normal(0.0, sigma_rad, (len(photos), 3)))
    ray = np.einsum("rij,rj->ri", off, ray)
    names = tuple(f"{photo}.jpg" for photo in photos)
    return KnownPoint(name, spot, 0.1, up if height else float("nan"), np.array(photos), names, ray)


def nothing(count):
    return known_at(np.zeros(count, np.complex128), [])


@pytest.mark.parametrize("height", [True, False])
def test_three_control_points_lay_a_submodel_without_any_placed_photo(court, rng, height):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    points = [
        clicked(submodel, at, name, [1, 7, 20], rng=rng, height=height) for name in ("gate", "well", "oak")
    ]
    found = georegister(submodel, nothing(40), points=points)
    assert isinstance(found.aligned, AlignedSubmodel)
    assert np.abs(found.aligned.at - at).max() < 1e-6
    assert not found.problems
    assert max(abs(fit.predicted - fit.at) for fit in found.points) < 1e-6
    assert not any(fit.contradicts for fit in found.points)


def test_heights_say_what_is_up_where_the_cameras_do_not(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng, tilt=3.0)
    points = [clicked(submodel, at, name, [1, 7, 20], rng=rng) for name in ("gate", "well", "oak")]
    assert np.abs(georegister(submodel, nothing(40), points=points).aligned.at - at).max() < 1e-6
    points = [
        clicked(submodel, at, name, [1, 7, 20], rng=rng, height=False) for name in ("gate", "well", "oak")
    ]
    refused = georegister(submodel, nothing(40), points=points).aligned
    assert "the vertical cannot be estimated" in refused.reason


def test_clicks_that_are_a_little_off_do_little_harm(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    sigma = np.radians(0.05)
    points = [clicked(submodel, at, name, [1, 7, 20, 33], rng=rng, sigma_rad=sigma) for name in SPOTS]
    assert np.abs(georegister(submodel, nothing(40), points=points).aligned.at - at).max() < 2.0


def test_a_control_point_helps_a_single_placed_photo(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    found = georegister(submodel, known_at(at, [5]), points=[clicked(submodel, at, "oak", [1, 7], rng=rng)])
    assert np.abs(found.aligned.at - at).max() < 1e-6
    assert found.aligned.transform.row.tolist() == [5, -1]
    assert found.aligned.transform.without(np.arange(40) == 5) is None


def test_a_click_that_disagrees_with_the_others_is_named(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    point = clicked(submodel, at, "gate", [1, 7, 20, 33], rng=rng)
    point.ray[2] = so3.retract(np.eye(3)[None], np.radians([[4.0, 3.0, 2.0]]))[0] @ point.ray[2]
    found = triangulate(point, submodel)
    assert found.wrong == ("20.jpg",)
    assert found.row.tolist() == [1, 7, 33]


@pytest.mark.parametrize(
    ("photos", "reason"),
    [
        ([1], "is clicked in one joined photo only, 1.jpg: click it in two or more"),
        ([77], "is not clicked in any joined photo: click it in two or more"),
    ],
)
def test_a_point_needs_two_photos_of_a_submodel(court, rng, photos, reason):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    point = clicked(submodel, at, "gate", [1], rng=rng)
    point = KnownPoint("gate", point.at, 0.1, 0.0, np.array(photos), point.shown_by, point.ray)
    found = triangulate(point, submodel)
    assert not found
    assert found.reason == reason


def test_rays_that_miss_each_other_or_are_parallel_are_no_point(court, rng):
    at, headings = court
    at[7] = at[1] + 0.01
    submodel = submodel_of(at, headings, rng=rng)
    found = triangulate(clicked(submodel, at, "gate", [1, 7], rng=rng), submodel)
    assert (
        found.reason
        == "1.jpg and 7.jpg show it from nearly the same direction: click it in one from the side"
    )
    point = clicked(submodel, at, "gate", [1, 20], rng=rng)
    point.ray[0, 1] += 0.2
    point.ray[0] /= np.linalg.norm(point.ray[0])
    found = triangulate(point, submodel)
    assert isinstance(found, NotTriangulated)
    assert found.reason == "the clicks in 1.jpg and 20.jpg contradict each other"


def test_a_control_point_at_a_wrong_place_of_the_map_is_named(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    points = [clicked(submodel, at, name, [1, 7, 20, 33], rng=rng, sigma_rad=1e-4) for name in SPOTS]
    wrong = points[3]
    points[3] = KnownPoint(
        "stone", wrong.at + 30.0, 0.1, wrong.height_px, wrong.photo, wrong.shown_by, wrong.ray
    )
    found = georegister(submodel, nothing(40), points=points)
    assert [fit.name for fit in found.points if fit.contradicts] == ["stone"]
    stone = found.points[3]
    assert abs(stone.predicted - wrong.at) < 2.0
    assert np.abs(found.aligned.at - at).max() < 2.0


def test_a_placed_photo_that_contradicts_control_points_is_found(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    known = known_at(at, [5, 6])
    known.at[6] += 40j
    points = [clicked(submodel, at, name, [1, 7, 20], rng=rng) for name in SPOTS]
    found = georegister(submodel, known, points=points)
    assert np.flatnonzero(found.aligned.contradicting).tolist() == [6]
    assert found.aligned.residual_px[6] == pytest.approx(40.0, abs=0.5)


def test_a_check_point_is_predicted_and_changes_nothing(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng, tilt=3.0)
    fitted = [clicked(submodel, at, name, [1, 7, 20], rng=rng) for name in ("gate", "well", "oak")]
    stone = clicked(submodel, at, "stone", [1, 7, 20, 33], rng=rng)
    alone = georegister(submodel, nothing(40), points=fitted).aligned
    for shift, up in ((0.0, 0.0), (30.0 - 40.0j, -6.0), (500.0j, 60.0)):
        moved = replace(stone, at=stone.at - shift, height_px=stone.height_px - up, is_check=True)
        found = georegister(submodel, nothing(40), points=[moved, *fitted])
        for field in ("at", "radius_px", "angle_deg", "residual_px", "predicted"):
            assert getattr(found.aligned, field).tobytes() == getattr(alone, field).tobytes()
        check = next(fit for fit in found.points if fit.name == "stone")
        assert check.predicted - check.at == pytest.approx(shift, abs=1e-6)
        assert check.height_off_px == pytest.approx(up, abs=1e-6)
        assert (check.photos, check.contradicts) == (4, False)
        assert 0.1 < check.sigma_px < 3.0


def test_placed_photos_alone_can_be_checked(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    stone = replace(clicked(submodel, at, "stone", [1, 7, 20], rng=rng), is_check=True)
    (check,) = georegister(submodel, known_at(at, [3, 5, 9, 12]), points=[stone]).points
    assert check.predicted == pytest.approx(check.at, abs=1e-6)
    assert np.isnan(check.height_off_px)  # photos have no heights on the map
    refused = georegister(submodel, nothing(40), points=[stone])
    assert "none of them is placed" in refused.aligned.reason
    assert np.isnan(refused.points[0].predicted)


def test_one_point_alone_is_too_little(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    found = georegister(submodel, nothing(40), points=[clicked(submodel, at, "oak", [1, 7], rng=rng)])
    assert found.aligned.reason == "only one position is known, that of the control point oak"


def test_three_points_that_fit_nothing_are_named(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    points = [
        clicked(submodel, at, name, [1, 7, 20], rng=rng, height=False) for name in ("gate", "well", "oak")
    ]
    moved = [100 + 100j, 500 + 110j, 105 + 120j]
    points = [
        KnownPoint(p.name, spot, 0.1, p.height_px, p.photo, p.shown_by, p.ray)
        for p, spot in zip(points, moved, strict=True)
    ]
    found = georegister(submodel, nothing(40), points=points)
    assert "gate, well, oak" in found.aligned.reason


def test_radii_of_an_adjusted_submodel_stay_those_of_its_covariances(rng):
    at = rng.uniform(100.0, 900.0, 12) + 1j * rng.uniform(100.0, 900.0, 12)
    centre = np.column_stack([at.real, at.imag, 0.0 * at.real])
    level = np.tile([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], (12, 1, 1))
    covariance = rng.uniform(1.0, 9.0, 12)[:, None, None] * np.eye(2)
    submodel = Submodel(np.arange(12), centre, level, covariance=covariance)
    known = known_at(at + rng.normal(0.0, 2.0, 12), np.arange(10), sigma_px=2.0)
    to = np.array([500.0, 500.0, -10.0]) - centre[:3]
    ray = np.einsum("rij,rj->ri", level[:3], to / np.linalg.norm(to, axis=1, keepdims=True))
    point = KnownPoint("oak", 500.0 + 500j, 1.0, np.nan, np.arange(3), ("0", "1", "2"), ray)
    aligned = georegister(submodel, known, points=[point]).aligned
    assert aligned.radius_px == pytest.approx(align_submodel(submodel, known).radius_px, rel=0.2)


def test_a_position_far_from_all_others_is_not_wrong_for_the_uncertainty_of_the_extrapolation(rng):
    for _ in range(100):
        plan = np.append(rng.uniform(-20.0, 20.0, 5) + 1j * rng.uniform(-20.0, 20.0, 5), 500.0)
        at = 2.0 * plan + rng.normal(0.0, 1.0, 6) + 1j * rng.normal(0.0, 1.0, 6)
        assert not len(outlying_positions(plan, at, sigma=np.ones(6)))
    at[2] += 100.0
    assert outlying_positions(plan, at, sigma=np.ones(6)).tolist() == [2]


def test_a_point_with_many_clicks_is_found_from_some_of_their_pairs(rng, monkeypatch):
    at, headings = (
        rng.uniform(100.0, 900.0, 200) + 1j * rng.uniform(100.0, 900.0, 200),
        rng.uniform(-3.0, 3.0, 200),
    )
    submodel = submodel_of(at, headings, rng=rng)
    point = clicked(submodel, at, "gate", [*range(200)], rng=rng, sigma_rad=1e-4)
    point.ray[50] = point.ray[51, ::-1]
    solved = []
    nearest = control_points._nearest
    monkeypatch.setattr(
        control_points, "_nearest", lambda *given, **near: solved.append(1) or nearest(*given, **near)
    )
    found = triangulate(point, submodel)
    assert found.wrong == ("50.jpg",)
    assert len(solved) <= 3000
