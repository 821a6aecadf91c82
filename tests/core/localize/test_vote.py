"""The method of 2013, on cases computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer
from webapp.core.localize import vote
from webapp.core.retrieval.engines.types import Neighbours, Segment
from webapp.core.retrieval.indexed import IndexedMap

ROWS_PER_PHOTO = 10
IDS = (0, 7, 3, 12)


class ListedSearch:
    """Returns prepared results: (row, distance) for each descriptor, nearest first."""

    def __init__(self, *neighbours: list[tuple[int, float]]) -> None:
        self.neighbours = neighbours

    def search(self, descriptors: np.ndarray, k: int) -> Neighbours:
        distance = np.full((len(descriptors), k), np.inf, np.float32)
        row = np.full((len(descriptors), k), -1, np.int64)
        for i, number in enumerate(descriptors[:, 0]):
            for j, (r, d) in enumerate(self.neighbours[number][:k]):
                row[i, j], distance[i, j] = r, d
        return Neighbours(distance, row)


def segment(photos: int, *, first_number: int) -> Segment:
    rows = photos * ROWS_PER_PHOTO
    number = np.arange(rows, dtype=np.float32) + first_number * ROWS_PER_PHOTO
    return Segment(
        content=[f"{first_number + i:064x}" for i in range(photos)],
        first=np.arange(photos + 1, dtype=np.int64) * ROWS_PER_PHOTO,
        xy=np.column_stack([number, number + 0.5]),
        size=np.ones(rows, np.float32),
        angle=np.zeros(rows, np.float32),
        descriptors=np.zeros((rows, 2), np.uint8),
        photo_size=np.full((photos, 2), 100, np.int32),
        fov_deg=np.full(photos, np.nan),
    )


def in_photo(number: int, row: int = 0) -> int:
    return number * ROWS_PER_PHOTO + row


def a_map(*neighbours: list[tuple[int, float]], gone: frozenset[int] = frozenset()) -> IndexedMap:
    """Return four photos in two segments; `gone` are entries removed from the map."""
    return IndexedMap(
        ids=np.array(IDS),
        position=np.array([[1.0, 2.0], [10.0, 20.0], [100.0, 200.0], [30.5, 40.25]]),
        fov_deg=np.full(4, 60.0),
        segments=[segment(1, first_number=0), segment(3, first_number=1)],
        photo_of_entry=np.array([-1 if i in gone else i for i in range(4)]),
        search=ListedSearch(*neighbours),
        place_radius_px=5.0,
    )


def query(keypoints: int) -> Features:
    descriptors = np.zeros((keypoints, 2), np.uint8)
    descriptors[:, 0] = np.arange(keypoints)
    xy = np.column_stack([np.arange(keypoints), 2 * np.arange(keypoints)]).astype(np.float32)
    ones = np.ones(keypoints, np.float32)
    return Features(xy, ones, ones, descriptors, (640, 480))


def listed(answer: Answer) -> list[tuple[int, float, int]]:
    return [(h.experiences[0], h.probability, h.matches) for h in answer.hypotheses]


def test_matches_farther_than_the_mean_are_dropped_and_the_rest_counted():
    themap = a_map(
        [(in_photo(1, 0), 10.0)],
        [(in_photo(1, 4), 20.0)],
        [(in_photo(3, 9), 30.0)],  # exactly the mean, so it is kept
        [(in_photo(2, 0), 40.0)],
        [(in_photo(2, 1), 50.0)],
    )
    answer = vote.localize(themap, query(5), top=5)
    assert listed(answer) == [(7, 2 / 3, 2), (12, 1 / 3, 1)]
    assert [h.rank for h in answer.hypotheses] == [1, 2]
    assert answer.hypotheses[0].position == MapPixel(10.0, 20.0)
    assert answer.hypotheses[1].position == MapPixel(30.5, 40.25)
    assert answer.other_probability == 0.0
    assert answer.no_pose is None
    assert not answer.abstained
    s = answer.statistics
    assert (s.keypoints, s.matches, s.matches_pruned) == (5, 5, 3)
    assert (s.distance_min, s.distance_max, s.distance_mean, s.distance_total) == (10.0, 50.0, 30.0, 150.0)


def test_what_the_method_does_not_know_is_null():
    answer = vote.localize(a_map([(0, 1.0)]), query(1), top=1)
    best = answer.hypotheses[0]
    assert (best.kind, best.radius_px, best.heading_deg, best.inliers) == ("photo", None, None, None)
    assert answer.off_map_probability is None
    assert answer.fov is None


@pytest.mark.parametrize("distance", [0.0, 123.456])
def test_exactly_one_match_gives_its_photo_with_certainty(distance):
    answer = vote.localize(a_map([], [(in_photo(2, 3), distance)], []), query(3), top=5)
    assert listed(answer) == [(3, 1.0, 1)]
    assert (answer.statistics.keypoints, answer.statistics.matches) == (3, 1)


@pytest.mark.parametrize("keypoints", [0, 2])
def test_no_match_is_no_pose_with_a_reason(keypoints):
    answer = vote.localize(a_map([], []), query(keypoints), top=5)
    assert answer.hypotheses == ()
    assert answer.no_pose is not None
    assert not answer.no_pose
    assert ("no keypoints" if keypoints == 0 else "no match") in answer.no_pose.reason
    assert answer.abstained
    s = answer.statistics
    assert (s.keypoints, s.matches, s.matches_pruned) == (keypoints, 0, 0)
    assert (s.distance_min, s.distance_max, s.distance_mean, s.distance_total) == (None,) * 4


@given(distance=st.floats(0.0, 1e4, width=32), n=st.integers(1, 60))
def test_equally_far_matches_all_stay(distance, n):
    themap = a_map(*[[(in_photo(1, i % ROWS_PER_PHOTO), distance)] for i in range(n)])
    answer = vote.localize(themap, query(n), top=5)
    assert listed(answer) == [(7, 1.0, n)]
    assert answer.statistics.matches_pruned == n


@given(
    photos=st.lists(st.tuples(st.integers(0, 3), st.floats(0, 500, width=32)), min_size=1, max_size=40),
    top=st.integers(1, 5),
)
def test_probabilities_are_shares_of_the_matches_left(photos, top):
    themap = a_map(*[[(in_photo(p, i % ROWS_PER_PHOTO), d)] for i, (p, d) in enumerate(photos)])
    answer = vote.localize(themap, query(len(photos)), top=top)
    left = answer.statistics.matches_pruned
    assert 1 <= left <= len(photos)
    assert len(answer.hypotheses) <= top
    assert sum(h.probability for h in answer.hypotheses) + answer.other_probability == pytest.approx(1.0)
    assert all(h.probability == h.matches / left for h in answer.hypotheses)
    counts = [h.matches for h in answer.hypotheses]
    assert counts == sorted(counts, reverse=True)
    if len(answer.hypotheses) < top:
        assert answer.other_probability == 0.0
        assert sum(counts) == left


def test_what_the_limit_cuts_is_the_other_probability():
    themap = a_map([(in_photo(0), 1.0)], [(in_photo(0), 1.0)], [(in_photo(1), 1.0)], [(in_photo(2), 1.0)])
    answer = vote.localize(themap, query(4), top=1)
    assert listed(answer) == [(0, 0.5, 2)]
    assert answer.other_probability == 0.5


def test_photos_with_equal_votes_come_in_the_maps_order():
    themap = a_map([(in_photo(3), 1.0)], [(in_photo(1), 1.0)], [(in_photo(2), 1.0)])
    assert [e for e, _, _ in listed(vote.localize(themap, query(3), top=5))] == [7, 3, 12]


def test_a_hidden_photo_leaves_its_matches_to_the_next_nearest():
    themap = a_map(
        [(in_photo(1, 0), 0.0), (in_photo(2, 5), 8.0)],
        [(in_photo(1, 1), 0.0), (in_photo(1, 2), 1.0), (in_photo(0, 0), 4.0)],
        [(in_photo(1, 3), 0.0)],
    )
    assert listed(vote.localize(themap, query(3), top=5)) == [(7, 1.0, 3)]
    answer = vote.localize(themap, query(3), top=5, hide={7})
    assert listed(answer) == [(0, 1.0, 1)]  # 8 is farther than the mean of 8 and 4
    assert (answer.statistics.matches, answer.statistics.distance_mean) == (2, 6.0)


def test_everything_hidden_is_no_pose():
    answer = vote.localize(a_map([(in_photo(1), 0.0)]), query(1), top=5, hide=set(IDS))
    assert answer.no_pose is not None


def test_the_best_photo_comes_with_its_matches():
    themap = a_map(
        [(in_photo(2, 4), 1.0)], [(in_photo(1, 0), 1.0)], [(in_photo(2, 6), 1.0)], [(in_photo(2, 7), 9.0)]
    )
    answer = vote.localize(themap, query(4), top=5)
    (evidence,) = answer.evidence
    assert evidence.experience == 3
    assert evidence.query_xy.tolist() == [[0.0, 0.0], [2.0, 4.0]]  # the match at 9 was dropped
    assert evidence.photo_xy.tolist() == [[24.0, 24.5], [26.0, 26.5]]
    assert not evidence.inlier.any()
