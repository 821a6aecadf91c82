"""Submodels are aligned with the map by some of their photos, or rejected with a reason."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.placing_simulations import PX_PER_M, model_of
from tests.core.landmarks.scene import known_at, submodel_of
from webapp.core.landmarks.placing import align_submodel, propose_next


@pytest.fixture
def court(rng):
    """Map pixels and headings of 40 photos around a court."""
    return rng.uniform(100.0, 900.0, 40) + 1j * rng.uniform(100.0, 900.0, 40), rng.uniform(-3.0, 3.0, 40)


@pytest.fixture
def walk():
    """Map pixels and headings of 40 photos along a straight path, all looking ahead."""
    return 100.0 + 20.0 * np.arange(40) + 300j, np.full(40, np.pi / 2)


def angles(result, headings):
    """Return the errors of the angles relative to the headings, degrees."""
    return np.abs((result.angle_deg - np.degrees(headings) + 180.0) % 360.0 - 180.0)


def test_two_photos_place_all_others_of_a_path_exactly(walk, rng):
    at, headings = walk
    result = align_submodel(submodel_of(at, headings, rng=rng), known_at(at, [0, 39]))
    assert np.abs(result.at - at).max() < 1e-9 * 1000
    assert angles(result, headings).max() < 1e-6


def test_cameras_that_are_tilted_and_not_equally_high_do_little_harm(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng, tilt=0.05, heights=10.0)
    result = align_submodel(submodel, known_at(at, [0, 1, 2, 3]))
    assert np.abs(result.at - at).max() < 20.0
    assert np.median(angles(result, headings)) < 5.0


def test_a_submodel_that_bends_follows_the_placed_photos(rng):
    at = 100.0 + 10.0 * np.arange(80) + 300j
    step = np.cumsum(np.exp(0.8j * np.sin(np.arange(80) / 25.0)) * (1.0 + 0.3 * np.sin(np.arange(80) / 9.0)))
    submodel = submodel_of(10.0 * step, np.full(80, np.pi / 2), rng=rng)
    result = align_submodel(submodel, known_at(at, np.arange(0, 80, 8)))
    error = np.abs(result.at - at)
    assert np.median(error) < 10.0
    assert np.mean(error <= result.radius_px) > 0.5


def test_the_radius_grows_with_the_distance_from_placed_photos(walk, rng):
    at, headings = walk
    result = align_submodel(submodel_of(at, headings, rng=rng), known_at(at, [0, 1, 2]))
    assert (np.diff(result.radius_px[2:]) > 0.0).all()


def test_a_wrong_position_is_found_and_does_not_count(court, rng):
    at, headings = court
    known = known_at(at, np.arange(10))
    known.at[4] += 400.0
    result = align_submodel(submodel_of(at, headings, rng=rng), known)
    assert np.flatnonzero(result.contradicting).tolist() == [4]
    assert result.residual_px[4] == pytest.approx(400.0, abs=1.0)
    assert np.abs(result.at - at).max() < 1.0


def test_less_exact_positions_count_less(court, rng):
    at, headings = court
    known = known_at(at, np.arange(8))
    known.at[:4] += rng.normal(0.0, 30.0, 4) + 1j * rng.normal(0.0, 30.0, 4)
    exact = align_submodel(submodel_of(at, headings, rng=rng), known)
    known.sigma_px[:4] = 30.0
    weighted = align_submodel(submodel_of(at, headings, rng=rng), known)
    assert np.median(np.abs(weighted.at - at)) < 0.5 * np.median(np.abs(exact.at - at))


def test_accepted_suggestions_prove_nothing(rng):
    """They fit the model that they come from, so radii and contradictions follow from the other positions."""
    at = rng.uniform(100.0, 900.0, 40) + 1j * rng.uniform(100.0, 900.0, 40)
    submodel = submodel_of(
        at + rng.normal(0.0, 15.0, 40) + 1j * rng.normal(0.0, 15.0, 40), np.zeros(40), rng=rng
    )
    known = known_at(at, np.arange(12))
    known.at[5] += 400.0
    before = align_submodel(submodel, known)
    accepted = np.arange(12, 36)
    known.at[accepted], known.derived[accepted] = before.at[accepted], True
    known.sigma_px[accepted] = before.radius_px[accepted] / 1.515
    after = align_submodel(submodel, known)
    assert before.contradicting[5]
    assert after.contradicting.tolist() == before.contradicting.tolist()
    used = np.flatnonzero(~before.contradicting[:12])
    assert after.residual_px[used] == pytest.approx(before.residual_px[used])
    assert after.transform.error_rate == pytest.approx(before.transform.error_rate)
    assert (after.radius_px[36:] > 0.5 * before.radius_px[36:]).all()
    off = np.abs(after.at[36:] - before.at[36:])
    assert (off < before.radius_px[36:]).all()


@pytest.mark.parametrize(
    ("placed", "reason"),
    [([], "none of them is placed"), ([3], "only one of them is placed")],
)
def test_too_few_positions_are_said(walk, rng, placed, reason):
    at, headings = walk
    result = align_submodel(submodel_of(at, headings, rng=rng), known_at(at, placed))
    assert not result
    assert result.reason == reason


def test_positions_at_one_spot_are_said(walk, rng):
    at, headings = walk
    known = known_at(at, [1, 2])
    known.at[2] = known.at[1]
    result = align_submodel(submodel_of(at, headings, rng=rng), known)
    assert result.reason == "the placed ones are all at the same position"


def test_mirrored_positions_are_refused(court, rng):
    at, headings = court
    known = known_at(at, np.arange(6))
    known.at[:6] = np.conj(known.at[:6]) + 1000j
    result = align_submodel(submodel_of(at, headings, rng=rng), known)
    assert result.reason == "the placed ones are a mirror image of what the photos show"
    assert result.photos == (0, 1, 2, 3, 4, 5)


def test_three_positions_that_fit_nothing_are_named(court, rng):
    at, headings = court
    known = known_at(at, [0, 1, 2])
    known.at[:3] = [100 + 100j, 500 + 110j, 105 + 500j]
    submodel = submodel_of(np.array([100 + 100j, 110 + 100j, 500 + 100j, *at[3:]]), headings, rng=rng)
    result = align_submodel(submodel, known)
    assert result.reason == "the positions of the placed ones contradict each other"
    assert result.photos == (0, 1, 2)


def test_cameras_without_a_common_up_need_three_positions_that_are_not_in_a_line(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng, tilt=3.0)
    result = align_submodel(submodel, known_at(at, [0, 1, 2]))
    assert np.abs(result.at - at).max() < 1e-6
    result = align_submodel(submodel, known_at(at, [0, 1]))
    assert "the vertical cannot be estimated" in result.reason


def test_photos_that_bring_most_onto_the_map_are_proposed_first(walk, rng):
    at, headings = walk
    submodel = submodel_of(at, headings, rng=rng)
    nothing = known_at(at, [])
    proposed = propose_next([submodel], [align_submodel(submodel, nothing)], known=nothing, most=6)
    assert sorted(proposed) == [0, 39]
    one = known_at(at, [10])
    assert propose_next([submodel], [align_submodel(submodel, one)], known=one, most=6) == [39]
    two = known_at(at, [0, 10])
    assert propose_next([submodel], [align_submodel(submodel, two)], known=two, most=6) == [39]


def proposed_of(submodels, at, placed, *, most):
    known = known_at(at, placed)
    aligned = [align_submodel(one, known) for one in submodels]
    return propose_next(submodels, aligned, known=known, most=most)


def test_a_camera_far_from_all_others_is_not_proposed(walk, rng):
    at, headings = walk
    at = np.where(np.arange(40) == 7, at + 9000.0, at)
    submodel = submodel_of(at, headings, rng=rng)
    assert sorted(proposed_of([submodel], at, [], most=2)) == [0, 39]
    assert proposed_of([submodel], at, [0], most=2) == [39]
    assert proposed_of([submodel], at, [0, 39], most=2) in ([19], [20])


def test_a_large_submodel_is_checked_before_a_small_one_is_placed(walk, rng):
    at, headings = walk
    large = submodel_of(at, headings, rng=rng)
    small = replace(submodel_of(at[:3], headings[:3], rng=rng), photo=np.arange(40, 43))
    both, placed = np.append(at, at[:3]), [0, 39]
    for _ in range(2):
        first, *others = proposed_of([large, small], both, placed, most=6)
        assert first < 40 and sorted(others) == [40, 42]
        placed.append(first)
    assert sorted(proposed_of([large, small], both, placed, most=2)) == [40, 42]


def test_what_else_is_known_in_a_submodel_is_laid_as_its_photos_are(court, rng):
    at, headings = court
    submodel = submodel_of(at, headings, rng=rng)
    result = align_submodel(submodel, known_at(at, range(0, 40, 2)))
    for row in (3, 4):
        point = result.transform.map_point(submodel.centre[row])
        assert abs(point.at - at[row]) < 1e-6
        assert abs(point.height_px) < 1e-6
        assert point.radius_px == pytest.approx(result.radius_px[row])
    frame = result.transform.frame
    above = result.transform.map_point(submodel.centre[3] - 0.037 * 12.0 * frame[2])
    assert above.height_px == pytest.approx(12.0)


def test_hidden_photos_do_not_lay_what_else_is_known(court, rng):
    at, headings = court
    moved = np.where(np.arange(40) == 4, at + 9.0, at)
    submodel = submodel_of(at, headings, rng=rng)
    transform = align_submodel(submodel, known_at(moved, range(0, 40, 2))).transform
    hidden = np.arange(40) == 4
    assert abs(transform.map_point(submodel.centre[4]).at - at[4]) > 0.1
    assert abs(transform.without(hidden).map_point(submodel.centre[4]).at - at[4]) < 1e-6
    assert transform.without(np.arange(40) != 4) is None


def flight(rng, *, pitch_deg):
    """Return map pixels of 30 photos in rows, all heading 40 degrees, and their model."""
    x, y = np.meshgrid(100.0 + 60.0 * np.arange(6), 100.0 + 80.0 * np.arange(5))
    at = (x + 1j * y).ravel()
    height = rng.normal(200.0, 2.0, 30)
    return at, model_of(
        at, height=height / PX_PER_M, heading=np.full(30, np.radians(40.0)), pitch_deg=pitch_deg, rng=rng
    )


@pytest.mark.parametrize(
    ("pitch_deg", "clicks"),
    [
        (-30.0, [0, 5, 29]),
        (-30.0, [0, 5, 14, 24, 29]),
        (-60.0, [0, 29]),  # with two, the plane of all cameras shows it only if they look down steeply
        (-60.0, [0, 5, 14, 24, 29]),
        (-90.0, [0, 29]),
        (-90.0, [0, 5, 29]),
        (-90.0, [0, 5, 14, 24, 29]),
    ],
)
def test_cameras_that_all_look_down_at_one_angle_are_seen_from_above(rng, pitch_deg, clicks):
    at, submodel = flight(rng, pitch_deg=pitch_deg)
    result = align_submodel(submodel, known_at(at, clicks))
    assert np.abs(result.at - at).max() < 8.0
    assert np.median(np.abs(result.angle_deg - 40.0)) < 1.5


def test_one_of_four_positions_that_is_wrong_is_named_and_does_not_count(walk, rng):
    at, headings = walk
    known = known_at(at, [0, 12, 25, 39])
    known.at[12] += 150j
    result = align_submodel(submodel_of(at, headings, rng=rng), known)
    assert np.flatnonzero(result.contradicting).tolist() == [12]
    assert result.residual_px[12] == pytest.approx(150.0, abs=1.0)
    assert result.predicted[12] == pytest.approx(at[12], abs=1.0)
    assert np.abs(result.at - at).max() < 1.0


def test_no_radius_is_below_what_left_out_positions_show(court, rng):
    """Where each camera is off by itself, one next to a placed photo is no better than the others."""
    at, headings = court
    off = 12.0 * (rng.normal(size=len(at)) + 1j * rng.normal(size=len(at)))
    submodel = submodel_of(at + off, headings, rng=rng)
    placed = np.arange(0, len(at), 3)
    aligned = align_submodel(submodel, known_at(at, placed, sigma_px=0.5))
    shown = np.nanmedian(aligned.residual_px)
    assert shown > 5.0
    assert aligned.radius_px.min() >= shown
