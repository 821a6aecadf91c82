"""Photos in a circle are verified in addition; they do not change the votes."""

import numpy as np

from webapp.core.features.types import Features
from webapp.core.localize.verified import find_places
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.indexed import IndexedMap

KEYPOINTS, COPIES, WIDTH = 40, 3, 32


def features(descriptors, rng):
    count = len(descriptors)
    return Features(
        xy=rng.uniform(0, 400, (count, 2)).astype(np.float32),
        size=np.ones(count, np.float32),
        angle=np.zeros(count, np.float32),
        descriptors=descriptors,
        photo_size=(400, 400),
    )


def map_and_query(noise):
    """Return a map of five photos with copies of the query's features and five without, and the query."""
    rng = np.random.default_rng(0)
    shown = rng.integers(0, 256, (KEYPOINTS, WIDTH))
    photos = []
    for alike in [True] * 5 + [False] * 5:
        rows = np.tile(shown, (COPIES, 1)) if alike else rng.integers(0, 256, (COPIES * KEYPOINTS, WIDTH))
        photos.append((rows + rng.normal(0.0, noise, rows.shape)).clip(0, 255).astype(np.uint8))
    rows = np.concatenate(photos)
    segment = Segment(
        content=[f"{i:064x}" for i in range(10)],
        first=np.arange(0, len(rows) + 1, COPIES * KEYPOINTS),
        xy=rng.uniform(0, 400, (len(rows), 2)).astype(np.float32),
        size=np.ones(len(rows), np.float32),
        angle=np.zeros(len(rows), np.float32),
        descriptors=rows,
        photo_size=np.full((10, 2), 400, np.int32),
        fov_deg=np.full(10, 60.0),
    )
    indexed = IndexedMap(
        ids=np.arange(10),
        position=np.column_stack([np.arange(10) * 100.0, np.zeros(10)]),
        fov_deg=np.full(10, 60.0),
        segments=[segment],
        photo_of_entry=np.arange(10),
        search=BruteForce([rows], "l2"),
        place_radius_px=10.0,
    )
    return indexed, features(shown.astype(np.uint8), rng)


def test_photos_without_a_vote_do_not_make_the_others_surer():
    indexed, query = map_and_query(noise=5.0)
    alone = find_places(indexed, query, fov_deg=60.0)
    hinted = find_places(indexed, query, fov_deg=60.0, include={7, 8})
    assert speaking(hinted) & {7, 8} and not speaking(alone) & {7, 8}
    assert np.allclose(hinted.evidence[0], alone.evidence[0], atol=1e-3)


def test_hidden_photos_are_not_looked_at():
    indexed, query = map_and_query(noise=5.0)
    found = find_places(indexed, query, fov_deg=60.0, hide={7}, include={7, 8})
    assert speaking(found) & {7, 8} == {8}


def test_photos_are_looked_at_also_where_all_look_the_same_and_none_has_a_vote():
    indexed, query = map_and_query(noise=0.0)
    assert not find_places(indexed, query, fov_deg=60.0).places
    found = find_places(indexed, query, fov_deg=60.0, include={7, 8})
    assert speaking(found) == {7, 8}
    assert np.isfinite(found.evidence).all()


def speaking(found):
    return {v.matched.photo for place in found.places for v in place.photos}
