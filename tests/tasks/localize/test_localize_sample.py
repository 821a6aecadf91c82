"""The whole pipeline on the sample map: index, calibration, positions, probabilities, off-map."""

import csv
import math
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.localize import verified
from webapp.core.retrieval.indexed import candidates
from webapp.core.retrieval.retrieve import filter_by_rotation, shortlist, weighted_votes
from webapp.core.tuning import CropsTuning
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.localize.calibrate import fit_trials
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.spot import photo_headings
from webapp.tasks.localize.trials import TriedMap, try_photos


@pytest.fixture(scope="module")
def localizer(ready_sample, tmp_path_factory):
    folder = tmp_path_factory.mktemp("chain") / "sample"
    shutil.copytree(ready_sample, folder)
    return open_pipeline(folder / "map.cfg", OpenOptions(jobs=1), settings=Settings(), progress=Progress())


def on_map(localizer, the_map):
    """Return the localizer with another state of its map."""
    (look,) = localizer.looks
    return replace(localizer, looks=(replace(look, opened=replace(look.opened, map=the_map)),))


def queries(localizer):
    folder = localizer.opened.cfg.parent
    with (folder / "queries.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file, delimiter=";"):
            yield folder / line["path"], (float(line["x"]), float(line["y"]))


def test_queries_are_found_where_they_were_taken(localizer):
    errors, first = [], []
    for path, truth in queries(localizer):
        answer = localizer.localize(path, top=5)
        errors.append(math.dist(answer.hypotheses[0].position, truth))
        first.append(answer)
    radius = localizer.place_radius_px
    assert np.mean(np.array(errors) <= radius) >= 0.9
    assert np.median(errors) <= 0.25 * radius
    found = [a for a, e in zip(first, errors, strict=True) if e <= radius]
    assert np.mean([a.hypotheses[0].probability for a in found]) > 0.6
    assert all(a.fov is not None and a.fov.source == "exif" for a in first)
    assert any(a.hypotheses[0].kind == "position" for a in first)


def bare_photos(localizer, tmp_path, change):
    """Yield changed queries without EXIF, and where they were taken."""
    for number, (path, truth) in enumerate(queries(localizer)):
        bare = tmp_path / f"{number}.jpg"
        cv2.imwrite(str(bare), change(cv2.imread(str(path))), [cv2.IMWRITE_JPEG_QUALITY, 95])
        yield bare, truth


def without_crops(localizer):
    """Return the localizer taking each photo for a whole one."""
    (look,) = localizer.looks
    tuning = replace(look.opened.indexed.tuning, crops=CropsTuning(shares=()))
    indexed = replace(look.opened.indexed, tuning=tuning)
    return replace(localizer, looks=(replace(look, opened=replace(look.opened, indexed=indexed)),))


def middle(photo):
    height, width = photo.shape[:2]
    return np.ascontiguousarray(photo[height // 4 : -height // 4, width // 4 : -width // 4])


@pytest.mark.parametrize("how", [np.copy, np.rot90])
def test_a_photo_of_the_size_of_the_maps_photos_is_a_whole_one(localizer, tmp_path, how):
    plain = without_crops(localizer)
    for path, _ in [*bare_photos(localizer, tmp_path, how)][:3]:
        ours, theirs = (each.localize(path, top=5) for each in (localizer, plain))
        assert ours.fov is not None and ours.fov.source == "guess"
        assert ours.hypotheses == theirs.hypotheses
        assert ours.off_map_probability == theirs.off_map_probability


@pytest.mark.parametrize(
    "change",
    [middle, lambda photo: cv2.resize(middle(photo), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)],
    ids=["crop", "zoom"],
)
def test_crops_are_seldom_surely_wrong(localizer, tmp_path, change):
    plain, radius = without_crops(localizer), localizer.place_radius_px
    wrong = {"with": 0, "without": 0}
    for path, truth in bare_photos(localizer, tmp_path, change):
        for name, each in (("with", localizer), ("without", plain)):
            first = each.localize(path, top=5).hypotheses[0]
            error = math.dist(first.position, truth)
            wrong[name] += first.probability >= 0.5 and error > radius
    assert wrong["without"] >= 4
    assert 2 * wrong["with"] <= wrong["without"]


def test_a_stated_field_of_view_is_the_only_one(localizer, tmp_path):
    path, _ = next(bare_photos(localizer, tmp_path, middle))
    answers = [
        replace(each, fov_deg=33.0).localize(path, top=5) for each in (localizer, without_crops(localizer))
    ]
    assert answers[0].hypotheses == answers[1].hypotheses
    assert answers[0].fov == answers[1].fov


def test_no_answer_is_more_exact_than_the_gps_of_the_photos(localizer):
    by_gps = [replace(e, by_gps=True, gps_accuracy_m=25.0) for e in localizer.opened.map.experiences]
    there = replace(localizer.opened.map, experiences=tuple(by_gps))
    path, _ = next(queries(localizer))
    exact, inexact = (
        on_map(localizer, on).localize(path, top=1).hypotheses[0] for on in (localizer.opened.map, there)
    )
    radius_m = inexact.radius_px * there.georeference.metres_per_pixel(inexact.position)
    assert exact.radius_px < 0.5 * inexact.radius_px
    assert radius_m >= 20.0
    assert inexact.probability == pytest.approx(exact.probability, abs=0.05)


def test_headings_count_from_north_on_an_image_that_is_turned(localizer):
    """With north to the left of the image, all headings change by a quarter turn."""
    east_up = Georeference("EPSG:32633", (0.0, -0.5, 500_000, -0.5, 0.0, 5_500_000, 0, 0, 1), "affine")
    on_it = replace(localizer.opened.map, georeference=east_up)
    turned = on_map(localizer, on_it)
    compared = 0
    for path, _ in [*queries(localizer)][:5]:
        one, other = (each.localize(path, top=1).hypotheses[0] for each in (localizer, turned))
        if one.heading_deg is not None:
            norths = [each.map.georeference.north_deg(one.position) for each in (localizer, turned)]
            assert norths[1] == pytest.approx(-90.0, abs=3.0)
            expected = one.heading_deg + norths[0] - norths[1]
            assert math.remainder(other.heading_deg - expected, 360.0) == pytest.approx(0.0, abs=1e-3)
            compared += 1
    assert compared >= 3


def test_headings_agree_with_those_of_the_photos_named(localizer):
    """A query and its best-matching photo have similar headings."""
    looked = {e.id: e.heading_deg for e in localizer.map.experiences}
    off = []
    for path, _ in queries(localizer):
        first = localizer.localize(path, top=1).hypotheses[0]
        if first.heading_deg is not None and looked.get(first.experiences[0]) is not None:
            off.append(abs(math.remainder(first.heading_deg - looked[first.experiences[0]], 360.0)))
    assert len(off) >= 5 and np.median(off) < 45.0


def test_computed_headings_of_the_photos_count_from_north_too(localizer):
    """They are compared with a compass if an answer has no heading."""
    bare = replace(
        localizer.opened.map,
        experiences=tuple(replace(e, heading_deg=None) for e in localizer.map.experiences),
    )
    east_up = Georeference("EPSG:32633", (0.0, -0.5, 500_000, -0.5, 0.0, 5_500_000, 0, 0, 1), "affine")
    one, other = (photo_headings(on_map(localizer, replace(bare, georeference=g))) for g in (None, east_up))
    assert len(one) >= 5 and one.keys() == other.keys()
    turned = [math.remainder(other[id] - one[id] - 90.0, 360.0) for id in one]
    assert np.abs(turned).max() < 3.0


@pytest.mark.parametrize("turn_deg", [25.0, -40.0, 90.0])
def test_photos_that_were_held_askew_are_placed_as_upright_ones(localizer, tmp_path, turn_deg):
    apart, turned_by = [], []
    for path, _ in [*queries(localizer)][:8]:
        upright = localizer.localize(path, top=1)
        photo = cv2.imread(str(path))
        height, width = photo.shape[:2]
        turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn_deg, 1.0)
        cv2.imwrite(str(tmp_path / "askew.png"), cv2.warpAffine(photo, turn, (width, height)))
        askew = replace(localizer, fov_deg=upright.fov.degrees).localize(tmp_path / "askew.png", top=1)
        one, other = upright.hypotheses[0], askew.hypotheses[0]
        if one.heading_deg is not None and other.heading_deg is not None:
            apart.append(math.dist(one.position, other.position))
            turned_by.append(abs(math.remainder(one.heading_deg - other.heading_deg, 360.0)))
    assert len(apart) >= 5
    assert np.median(apart) < 0.2 * localizer.place_radius_px
    assert np.median(turned_by) < 3.0


def test_every_answer_adds_up_and_is_ranked(localizer):
    for path, _ in queries(localizer):
        answer = localizer.localize(path, top=2)
        listed = [h.probability for h in answer.hypotheses]
        total = sum(listed) + answer.other_probability + answer.off_map_probability
        assert total == pytest.approx(1.0, abs=1e-9)
        assert listed == sorted(listed, reverse=True)
        assert [h.rank for h in answer.hypotheses] == list(range(1, len(listed) + 1))
        assert all(0 < h.radius_px <= localizer.place_radius_px for h in answer.hypotheses)
        compared = [one.experience for one in answer.evidence]
        assert len(compared) == len(set(compared))


def test_a_photo_from_elsewhere_is_not_on_the_map(localizer):
    answer = localizer.localize(localizer.opened.cfg.parent / "queries" / "off_map.jpg", top=5)
    assert answer.abstained
    assert answer.hypotheses[0].probability < 0.3 < answer.off_map_probability


def test_headings_point_where_the_camera_looked(localizer):
    apart = []
    headings = {e.id: e.heading_deg for e in localizer.map.experiences}
    folder = localizer.opened.cfg.parent
    for experience in localizer.map.experiences[::6]:
        answer = localizer.localize(folder / experience.photo, top=1, hide=frozenset({experience.id}))
        best = answer.hypotheses[0]
        if best.heading_deg is not None and math.dist(best.position, experience.position) < 40:
            apart.append(abs(math.remainder(best.heading_deg - headings[experience.id], 360.0)))
    assert len(apart) >= 4
    assert np.median(apart) < 10.0


def test_a_photo_of_the_map_itself_is_its_own_best_evidence(localizer):
    experience = localizer.map.experiences[10]
    answer = localizer.localize(localizer.opened.cfg.parent / experience.photo, top=1)
    assert answer.evidence[0].experience == experience.id
    assert answer.evidence[0].inlier.mean() > 0.9
    assert np.abs(answer.evidence[0].query_xy - answer.evidence[0].photo_xy).max() < 1.0


def test_a_hidden_photo_never_speaks(localizer):
    experience = localizer.map.experiences[10]
    hide = frozenset({experience.id, 11, 12})
    answer = localizer.localize(localizer.opened.cfg.parent / experience.photo, top=9, hide=hide)
    assert not hide & {e for h in answer.hypotheses for e in h.experiences}


def test_turned_matches_are_dropped_before_the_vote(localizer):
    indexed = localizer.opened.indexed
    query = indexed.features(20)
    found = candidates(indexed, np.asarray(query.descriptors), k=8, hide={20})
    kept = filter_by_rotation(indexed, query, found=found)
    assert kept.photo.shape == found.photo.shape
    assert 0 < (kept.photo >= 0).sum() < 0.8 * (found.photo >= 0).sum()
    votes = weighted_votes(kept, len(indexed.ids))
    assert abs(int(votes.argmax()) - 20) <= 2
    listed = shortlist(indexed, query, found=kept, votes=votes, most=4)
    assert [s.photo for s in listed] == list(np.argsort(-votes, kind="stable")[:4])
    assert all(len(np.unique(s.query_row)) == len(s.query_row) == len(s.photo_xy) for s in listed)


def test_calibration_is_repeatable_and_from_the_maps_own_photos(localizer):
    indexed = localizer.opened.indexed
    known = with_hidden_photos(localizer).looks[0].sightings
    one, two = (
        fit_trials(indexed, [*try_photos(TriedMap(indexed, known), Progress()).values()]) for _ in range(2)
    )
    assert one == two == localizer.looks[0].calibration.calibration
    assert 40 <= one.cases <= 60
    assert one.radius_scale >= 1.0


def test_a_featureless_photo_has_no_place_and_says_why(localizer):
    empty = localizer.opened.indexed.features(0)
    nothing = type(empty)(
        empty.xy[:0], empty.size[:0], empty.angle[:0], np.asarray(empty.descriptors)[:0], (640, 480)
    )
    found = verified.find_places(localizer.opened.indexed, nothing, fov_deg=65.0)
    assert not found.places
    assert not found.answer.no_pose and "no keypoints" in found.answer.no_pose.reason
    assert found.answer.off_map_probability == 1.0
