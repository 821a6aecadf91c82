"""Photos with a similar global descriptor join the shortlist; the votes keep most of it."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.features.types import Features
from webapp.core.localize.evidence import Spots, similarity_around
from webapp.core.localize.verified import find_places
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.global_descriptors import GlobalDescriptors
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import fused_ranking, with_similar

PHOTOS, KEYPOINTS, WIDTH = 24, 30, 32


def described(vectors, row=None):
    row = np.arange(len(vectors)) if row is None else row
    return GlobalDescriptors(None, np.asarray(vectors, np.float16), np.asarray(row))


def a_map(vectors=None):
    """Return a map of photos 100 map pixels apart, with random keypoints."""
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 256, (PHOTOS * KEYPOINTS, WIDTH)).astype(np.uint8)
    segment = Segment(
        content=[f"{i:064x}" for i in range(PHOTOS)],
        first=np.arange(0, len(rows) + 1, KEYPOINTS),
        xy=rng.uniform(0, 400, (len(rows), 2)).astype(np.float32),
        size=np.ones(len(rows), np.float32),
        angle=np.zeros(len(rows), np.float32),
        descriptors=rows,
        photo_size=np.full((PHOTOS, 2), 400, np.int32),
        fov_deg=np.full(PHOTOS, 60.0),
    )
    return IndexedMap(
        ids=np.arange(PHOTOS),
        position=np.column_stack([np.arange(PHOTOS) * 100.0, np.zeros(PHOTOS)]),
        fov_deg=np.full(PHOTOS, 60.0),
        segments=[segment],
        photo_of_entry=np.arange(PHOTOS),
        search=BruteForce([rows], "l2"),
        place_radius_px=10.0,
        global_descriptors=None if vectors is None else described(vectors),
    )


@pytest.fixture
def vectors():
    """Return dissimilar vectors of the photos."""
    found = np.random.default_rng(1).normal(size=(PHOTOS, 64))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def query(vector=None, *, of=None, keypoints=KEYPOINTS):
    """Return a query that shows nothing of the map, or the photo `of` with noise."""
    rng = np.random.default_rng(2)
    shown = rng.integers(0, 256, (keypoints, WIDTH))
    xy = rng.uniform(0, 400, (keypoints, 2))
    if of is not None:
        features = a_map().features(of)
        shown, xy = features.descriptors + rng.normal(0, 3, (KEYPOINTS, WIDTH)), features.xy
    return Features(
        xy=np.asarray(xy, np.float32),
        size=np.ones(keypoints, np.float32),
        angle=np.zeros(keypoints, np.float32),
        descriptors=np.clip(shown, 0, 255).astype(np.uint8),
        photo_size=(400, 400),
        vector=None if vector is None else np.asarray(vector, np.float32),
    )


def speaking(found):
    return {v.matched.photo for place in found.places for v in place.photos}


def test_scores_are_standardised_over_the_photos_that_are_seen(vectors):
    known = described(vectors, [*range(PHOTOS - 1), -1])
    visible = np.arange(PHOTOS) != 3
    scores = known.standard_scores(vectors[5].astype(np.float32), visible=visible)
    assert np.isneginf(scores[[3, PHOTOS - 1]]).all()
    seen = scores[np.isfinite(scores)]
    assert len(seen) == PHOTOS - 2
    assert (seen.mean(), seen.std()) == pytest.approx((0.0, 1.0))
    assert scores.argmax() == 5


def test_photos_that_are_all_alike_say_nothing():
    same = described(np.tile([[0.6, 0.8]], (4, 1)))
    scores = same.standard_scores(np.array([1.0, 0.0], np.float32), visible=np.ones(4, bool))
    assert (scores == 0.0).all()
    assert np.isneginf(
        same.standard_scores(np.array([1.0, 0.0], np.float32), visible=np.zeros(4, bool))
    ).all()


def test_what_both_rankings_name_comes_first():
    assert fused_ranking([1, 2, 3], [4, 2, 5]) == [2, 1, 4, 3, 5]
    assert fused_ranking([], [3, 1]) == [3, 1]


def test_the_evidence_is_that_of_the_best_photo_around():
    indexed = a_map()
    alike = np.full(PHOTOS, -np.inf)
    alike[[2, 4, 5]] = 2.0, -1.0, 3.0
    at = Spots(np.array([[200.0, 0.0], [210.0, 0.0], [400.0, 0.0], [500.0, 0.0]]), np.full(4, -1))
    found = similarity_around(indexed, alike, at=at)
    assert found == pytest.approx([2.0, 2.0 * np.exp(-0.5), 0.0, 3.0])
    assert (similarity_around(indexed, None, at=at) == 0.0).all()


def test_within_an_area_all_photos_count():
    indexed = replace(a_map(), area=np.arange(PHOTOS) // 8)
    alike = np.full(PHOTOS, -1.0)
    alike[7] = 2.0
    found = similarity_around(indexed, alike, at=Spots(np.zeros((2, 2)), np.array([0, 1])))
    assert found.tolist() == [2.0, 0.0]


def test_a_place_that_only_its_look_names_is_found(vectors):
    plain = find_places(a_map(), query(), fov_deg=60.0)
    found = find_places(a_map(vectors), query(vectors[17]), fov_deg=60.0)
    at = {p.position.x: e for p, e in zip(found.places, found.evidence, strict=True)}
    assert at[1700.0][-1] == max(e[-1] for e in at.values()) > np.log1p(3.0)
    assert 1700.0 not in {p.position.x for p in plain.places}
    assert not plain.evidence[:, -1].any()


def test_it_is_found_without_any_keypoint_too(vectors):
    found = find_places(a_map(vectors), query(vectors[17], keypoints=0), fov_deg=60.0)
    assert found.places[0].position.x == 1700.0


def test_photos_that_the_votes_name_stay(vectors):
    found = find_places(a_map(vectors), query(vectors[17], of=3), fov_deg=60.0)
    assert found.places[0].position.x == 300.0
    assert {3, 17} <= speaking(found)
    similar = next(v for p in found.places for v in p.photos if v.matched.photo == 17)
    assert len(similar.matched.query_row) < KEYPOINTS / 2, "chance matches few, once they must be mutual"


@pytest.mark.parametrize("binary", [False, True])
def test_a_photo_without_votes_is_matched_with_the_query(binary):
    indexed = replace(a_map(), binary=binary)
    alike = np.where(np.arange(PHOTOS) == 3, 4.0, -np.inf)
    listed, further = with_similar(indexed, query(of=3), voting=[], votes=np.zeros(PHOTOS), alike=alike)
    (found,) = listed
    assert (found.photo, found.votes, further) == (3, 0.0, [])
    assert (found.query_row == found.photo_row).all() and len(found.query_row) > 0.8 * KEYPOINTS
    assert (found.query_xy == found.photo_xy).all()


def test_hidden_photos_are_hidden_from_it(vectors):
    found = find_places(a_map(vectors), query(vectors[17]), fov_deg=60.0, hide={17})
    assert 17 not in speaking(found)
    assert 1700.0 not in {p.position.x for p in found.places}


def test_without_a_vector_nothing_changes(vectors):
    with_model, without = (find_places(m, query(of=3), fov_deg=60.0) for m in (a_map(vectors), a_map()))
    assert (with_model.evidence == without.evidence).all()
    assert [p.position for p in with_model.places] == [p.position for p in without.places]
    assert [[v.matched.photo for v in p.photos] for p in with_model.places] == [
        [v.matched.photo for v in p.photos] for p in without.places
    ]


def test_a_photo_has_its_own_vector(vectors):
    indexed = a_map(vectors)
    assert np.allclose(indexed.features(4).vector, vectors[4], atol=1e-3)
    assert indexed.features(4).subset(np.arange(3)).vector is not None
    assert a_map().features(4).vector is None
