"""A network's matches replace those of the search; votes and order stay."""

from dataclasses import replace

import numpy as np
import pytest

from webapp.core.features.types import Features
from webapp.core.localize.verified import find_places
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import ShortlistedPhoto, rematch_with_network

PHOTOS, KEYPOINTS, WIDTH = 3, 30, 32


class Reversed:
    """Matches the first keypoint with the last, and so on, which no search would."""

    def match(self, query: Features, photo: Features) -> np.ndarray:
        rows = np.arange(len(query))
        return np.column_stack([rows, rows[::-1]])


def map_and_query():
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
    indexed = IndexedMap(
        ids=np.arange(PHOTOS),
        position=np.column_stack([np.arange(PHOTOS) * 100.0, np.zeros(PHOTOS)]),
        fov_deg=np.full(PHOTOS, 60.0),
        segments=[segment],
        photo_of_entry=np.arange(PHOTOS),
        search=BruteForce([rows], "l2"),
        place_radius_px=10.0,
    )
    return indexed, segment.entry(0).features


def test_matches_are_the_networks_and_votes_the_searchs():
    indexed, query = map_and_query()
    found_by_search = np.arange(4)
    listed = [
        ShortlistedPhoto(photo, votes, found_by_search, found_by_search, query.xy[:4], query.xy[:4])
        for photo, votes in ((2, 7.0), (0, 3.0))
    ]
    rematched = rematch_with_network(indexed, query, listed=listed, matcher=Reversed())
    assert [(one.photo, one.votes) for one in rematched] == [(2, 7.0), (0, 3.0)]
    for one in rematched:
        assert np.array_equal(one.query_row, np.arange(KEYPOINTS))
        assert np.array_equal(one.photo_row, np.arange(KEYPOINTS)[::-1])
        assert np.array_equal(one.query_xy, query.xy)
        assert np.array_equal(one.photo_xy, indexed.features(one.photo).xy[::-1])


def test_places_are_found_with_the_networks_matches():
    indexed, query = map_and_query()
    usual = find_places(indexed, query, fov_deg=60.0).places[0].photos[0].matched
    thorough = replace(indexed, pair_matcher=Reversed())
    rematched = find_places(thorough, query, fov_deg=60.0).places[0].photos[0].matched
    assert np.array_equal(usual.photo_xy[:5], query.xy[:5])
    assert np.array_equal(rematched.photo_xy, query.xy[::-1])


class Counting:
    """Matches each keypoint with that of the same number, except in the first photos; counts the photos."""

    def __init__(self, unmatched):
        self.unmatched, self.asked = unmatched, 0

    def match(self, query: Features, photo: Features) -> np.ndarray:
        self.asked += 1
        rows = np.arange(0 if self.asked <= self.unmatched else len(query))
        return np.column_stack([rows, rows])


@pytest.mark.parametrize(("unmatched", "asked"), [(0, 1), (1, PHOTOS)])
def test_a_second_look_matches_more_photos_where_the_first_ones_do_not_show_the_same(unmatched, asked):
    indexed, query = map_and_query()
    matcher = Counting(unmatched)
    retrieval = replace(indexed.tuning.retrieval, certain_inliers=15)
    look = replace(
        indexed, pair_matcher=matcher, rematched=1, tuning=replace(indexed.tuning, retrieval=retrieval)
    )
    find_places(look, query, fov_deg=60.0)
    assert matcher.asked == asked
