"""Drifted submodels are joined and adjusted at known positions."""

import numpy as np
import pycolmap
import pytest

from tests.files.landmarks.drifted_walk import PHOTOS, drifted, walk, write_matches
from webapp.core.landmarks.control_points import KnownPoint
from webapp.core.landmarks.georegister import georegister
from webapp.core.landmarks.placing import KnownPositions
from webapp.core.landmarks.submodels import Submodel, fit_similarity
from webapp.files.landmarks import adjust as adjusting
from webapp.files.landmarks.adjust import adjust, agreed_rotation
from webapp.files.landmarks.colmap import StoredSubmodels, as_model
from webapp.tasks.landmarks.adjust import Facts, adjust_job, positions_of

CONTENTS = tuple(str(number) for number in range(PHOTOS))
SCALE = 10.0
"""Map pixels per metre."""


@pytest.fixture
def scene(tmp_path):
    """A folder with the model and its matches, and the centres and rotations in order."""
    found = drifted(np.random.default_rng(3))
    (tmp_path / "models" / "0").mkdir(parents=True)
    found.write(tmp_path / "models" / "0")
    write_matches(found, tmp_path / "matches.db")
    model = as_model(found)
    order = [model.contents.index(name) for name in CONTENTS]
    return tmp_path, model.centre[order], model.rotation[order]


def make_job(scene, submodels, *, at, placed, points=()):
    """Return the job to adjust submodels (ranges of photos) by placed photos and control points."""
    folder, centre, rotation = scene
    known = KnownPositions(
        np.where(
            np.isin(np.arange(PHOTOS), placed), SCALE * (at[:, 0] + 1j * at[:, 1]), complex(np.nan, np.nan)
        ),
        np.full(PHOTOS, 1.0),
        np.zeros(PHOTOS, np.bool_),
    )
    rigid = [
        Submodel(np.array(numbers), centre[numbers], rotation[numbers]) for numbers in map(list, submodels)
    ]
    aligned = [(submodel, georegister(submodel, known, points=points).aligned) for submodel in rigid]
    for submodel, result in aligned:
        known.at[submodel.photo[result.contradicting]] = complex(np.nan, np.nan)
    stored = StoredSubmodels(tuple(rigid), CONTENTS, "key")
    positions = positions_of(
        CONTENTS, Facts(known, points), photo=np.arange(PHOTOS), turn_deg=np.zeros(PHOTOS, np.int64)
    )
    matches, out = folder / "matches.db", folder / "adjusted"
    return adjust_job(stored, positions, aligned=aligned, matches=matches, folder=folder, out=out)


def joined(scene, submodels, *, at, placed, points=()):
    """Lay submodels and join them; return centres in metres by number."""
    model = adjust(make_job(scene, submodels, at=at, placed=placed, points=points))
    if model is None:
        return None
    return {int(name): at / SCALE for name, at in zip(model.contents, model.centre, strict=True)}


def off(found, truth):
    return np.array([np.linalg.norm((at - truth[number])[:2]) for number, at in found.items()])


def test_a_walk_that_bends_is_straightened_by_five_positions(scene):
    truth, placed = walk()[0], [0, 5, 11, 16, 21]
    bent = fit_similarity(scene[1][placed], truth[placed]).apply(scene[1]) - truth
    assert np.median(np.linalg.norm(bent, axis=1)) > 1.5
    found = joined(scene, [range(PHOTOS)], at=truth, placed=placed)
    assert len(found) == PHOTOS
    assert off(found, truth).max() < 0.1
    assert (scene[0] / "adjusted" / "images.bin").exists()


def test_where_little_holds_a_walk_it_is_less_certain(scene):
    """Positions at one end only: uncertainty grows with the distance from them, and covers the errors."""
    truth, placed = walk()[0], [0, 1, 3, 5, 7]
    model = adjust(make_job(scene, [range(PHOTOS)], at=truth, placed=placed))
    order = [model.contents.index(name) for name in CONTENTS]
    sigma_px = np.sqrt(np.trace(model.covariance[order], axis1=1, axis2=2) / 2.0)
    assert (np.diff(sigma_px[8:]) > 0.0).all()
    away_px = SCALE * np.linalg.norm((model.centre[order] / SCALE - truth)[:, :2], axis=1)
    assert np.mean(away_px < 3.0 * sigma_px) > 0.9
    assert sigma_px[-1] > 5.0 * sigma_px[4]


def test_one_wrong_position_does_not_pull_the_others(scene):
    truth, placed = walk()[0], [*range(0, PHOTOS, 3)]
    at = truth + np.where(np.arange(PHOTOS) == 12, 9.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    found = joined(scene, [range(PHOTOS)], at=at, placed=placed)
    assert off(found, truth).max() < 0.1
    assert np.linalg.norm((found[12] - at[12])[:2]) == pytest.approx(9.0, abs=0.1)


SPOTS = {
    f"spot {number}": walk()[0][number] + [2.0, -1.0, 14.0] @ walk()[1][number] for number in range(0, 19, 3)
}
"""Points ahead of some of the photos, metres."""


def seen_point(name, *, moved_m=0.0):
    """Return a control point clicked in all photos that see it, with an error of its map position."""
    centre, rotation = walk()
    ray = np.einsum("nij,nj->ni", rotation, SPOTS[name] - centre)
    ahead = (ray[:, 2] > 3.0) & (ray[:, 2] < 25.0) & (np.abs(ray[:, :2]).max(1) < 0.5 * ray[:, 2])
    photos = np.flatnonzero(ahead)
    ray = ray[photos] / np.linalg.norm(ray[photos], axis=1, keepdims=True)
    at = SCALE * complex(SPOTS[name][0] + moved_m, SPOTS[name][1])
    return KnownPoint(name, at, 0.3, np.nan, photos, tuple(CONTENTS[n] for n in photos), ray)


def test_control_points_straighten_a_walk_of_which_no_photo_is_placed(scene):
    truth, points = walk()[0], [seen_point(name) for name in SPOTS]
    job = make_job(scene, [range(PHOTOS)], at=truth, placed=[], points=points)
    before = {int(name): at / SCALE for name, at in zip(job.contents, job.centre, strict=True)}
    assert np.median(off(before, truth)) > 3.0
    found = joined(scene, [range(PHOTOS)], at=truth, placed=[], points=points)
    assert len(found) == PHOTOS
    assert off(found, truth).max() < 0.15
    model = pycolmap.Reconstruction(scene[0] / "adjusted")
    assert {image.name for image in model.images.values()} == {*CONTENTS}, "what stood for points is gone"


def test_placed_photos_and_control_points_adjust_a_walk_together(scene):
    """Photos at one end leave the other uncertain; control points there constrain it."""
    truth, placed = walk()[0], [0, 1, 3, 5, 7]
    points, last = [seen_point("spot 15"), seen_point("spot 18")], CONTENTS[-1]
    away_m, sigma_px = {}, {}
    for some in ([], points):
        model = adjust(make_job(scene, [range(PHOTOS)], at=truth, placed=placed, points=some))
        row = model.contents.index(last)
        away_m[len(some)] = np.linalg.norm((model.centre[row] / SCALE - truth[-1])[:2])
        sigma_px[len(some)] = np.sqrt(np.trace(model.covariance[row]) / 2.0)
    assert away_m[2] < min(0.1, away_m[0])
    assert sigma_px[2] < 0.7 * sigma_px[0]


def test_two_submodels_become_one_with_the_photos_between_them(scene):
    truth, placed = walk()[0], [0, 4, 8, 10, 13, 17, 21]
    # 9 and 11 are unknown, 10 is placed; none is in a submodel
    found = joined(scene, [range(9), range(12, PHOTOS)], at=truth, placed=placed)
    assert sorted(found) == [*range(PHOTOS)]
    assert off(found, truth).max() < 0.1


def test_submodels_stay_where_their_photos_would_not_agree_any_more(scene, monkeypatch):
    monkeypatch.setattr(adjusting, "_KEPT", 1.5)
    truth = walk()[0]
    assert joined(scene, [range(PHOTOS)], at=truth, placed=[0, 5, 16, 21]) is None
    assert not (scene[0] / "adjusted").exists()


def test_most_matches_decide_on_a_rotation():
    about = np.eye(3)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotation, support = agreed_rotation([(about, 20), (turned, 30), (about, 15)])
    np.testing.assert_allclose(rotation, about, atol=1e-12)
    assert support == 35


@pytest.mark.parametrize(("side_px", "pixel"), [(1000, 1.0), (320, 2.0)])
def test_keypoints_of_large_photos_are_less_exact(scene, monkeypatch, side_px, pixel):
    monkeypatch.setattr(adjusting, "_SIDE_PX", side_px)
    job = make_job(scene, [range(PHOTOS)], at=walk()[0], placed=[0, 5, 16, 21])
    assert adjusting._Scene(job)._pixel == pixel
