"""Indices of matched keypoints within their photo, also with several segments, empty and removed photos."""

import numpy as np

from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.indexed import IndexedMap, candidates
from webapp.core.retrieval.retrieve import shortlist, weighted_votes

LENGTHS = [[0, 5, 0, 7], [6, 0, 4]]


def segment(lengths, rows):
    first = np.concatenate([[0], np.cumsum(lengths)])
    count = int(first[-1])
    return Segment(
        content=[f"{i:064x}" for i in range(len(lengths))],
        first=first,
        xy=np.column_stack([np.arange(count), np.arange(count)]).astype(np.float32),
        size=np.ones(count, np.float32),
        angle=np.zeros(count, np.float32),
        descriptors=rows,
        photo_size=np.full((len(lengths), 2), 400, np.int32),
        fov_deg=np.full(len(lengths), 60.0),
    )


def the_map():
    """Six photos, and one of seven entries that is no longer on the map."""
    rng = np.random.default_rng(0)
    segments = [segment(n, rng.integers(0, 256, (sum(n), 32)).astype(np.uint8)) for n in LENGTHS]
    photo_of_entry = np.array([0, 1, 2, 3, -1, 4, 5])
    return IndexedMap(
        ids=np.arange(6),
        position=np.column_stack([np.arange(6) * 100.0, np.zeros(6)]),
        fov_deg=np.full(6, 60.0),
        segments=segments,
        photo_of_entry=photo_of_entry,
        search=BruteForce([s.descriptors for s in segments], "l2"),
        place_radius_px=10.0,
    )


def test_rows_are_counted_from_the_photos_first():
    rows = np.arange(22)
    expected = [*range(5), *range(7), *range(6), *range(4)]
    assert the_map().row_in_photo(rows).tolist() == expected
    assert the_map().row_in_photo(rows.reshape(2, 11)).shape == (2, 11)


def test_matches_name_the_keypoints_of_their_photo():
    indexed = the_map()
    for photo in (1, 3, 5):
        query = indexed.features(photo)
        found = candidates(indexed, query.descriptors, k=3)
        votes = weighted_votes(found, len(indexed.ids))
        best = shortlist(indexed, query, found=found, votes=votes, most=1)[0]
        assert best.photo == photo
        exact = np.flatnonzero(best.photo_row == best.query_row)
        assert len(exact) == len(query)
        assert (indexed.features(photo).xy[best.photo_row] == best.photo_xy).all()
