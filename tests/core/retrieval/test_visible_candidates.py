"""Neighbours among visible photos: not removed, not hidden."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.retrieval import indexed as module
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.indexed import IndexedMap, candidates


def a_map(rows_of_photos: list[int], *, gone: set[int], seed: int) -> IndexedMap:
    """Return a map with random descriptors in two segments; `gone` are entries removed from the map."""
    rng = np.random.default_rng(seed)
    half = len(rows_of_photos) // 2
    segments = []
    for part in (rows_of_photos[:half], rows_of_photos[half:]):
        rows = sum(part)
        segments.append(
            Segment(
                content=[f"{rng.integers(2**60):064x}" for _ in part],
                first=np.cumsum([0, *part], dtype=np.int64),
                xy=rng.random((rows, 2), np.float32),
                size=np.ones(rows, np.float32),
                angle=rng.random(rows, np.float32),
                descriptors=rng.integers(0, 4, (rows, 8), np.uint8),
                photo_size=np.column_stack([np.arange(len(part)) + 100, np.full(len(part), 50)]).astype(
                    np.int32
                ),
                fov_deg=np.full(len(part), np.nan),
            )
        )
    alive = [i for i in range(len(rows_of_photos)) if i not in gone]
    photo_of_entry = np.full(len(rows_of_photos), -1)
    # The order of the map differs from that of the index.
    photo_of_entry[alive] = np.arange(len(alive))[::-1]
    return IndexedMap(
        ids=np.arange(len(alive)) * 10,
        position=np.zeros((len(alive), 2)),
        fov_deg=np.full(len(alive), 60.0),
        segments=segments,
        photo_of_entry=photo_of_entry,
        search=BruteForce([s.descriptors for s in segments], "l2"),
        place_radius_px=1.0,
    )


@given(
    rows=st.lists(st.integers(0, 12), min_size=2, max_size=8),
    gone=st.sets(st.integers(0, 7), max_size=6),
    hide=st.sets(st.integers(0, 7), max_size=6),
    k=st.integers(1, 6),
    seed=st.integers(0, 2**32 - 1),
)
def test_as_if_the_others_were_not_in_the_map(rows, gone, hide, k, seed):
    gone = {g for g in gone if g < len(rows)}
    if len(gone) == len(rows):
        gone.pop()
    themap = a_map(rows, gone=gone, seed=seed)
    hide_ids = {10 * h for h in hide}
    query = np.random.default_rng(seed + 1).integers(0, 4, (5, 8), np.uint8)
    found = candidates(themap, query, k=k, hide=hide_ids)
    every = np.concatenate([s.descriptors for s in themap.segments])
    photo_of_row = np.repeat(themap.photo_of_entry, rows)
    seen = np.array([p >= 0 and themap.ids[p] not in hide_ids for p in photo_of_row], bool)
    apart = np.sqrt(((query[:, None].astype(int) - every[None]) ** 2).sum(2))
    have = min(k, int(seen.sum()))
    assert found.distance.shape == found.row.shape == found.photo.shape == (5, k)
    assert np.allclose(found.distance[:, :have], np.sort(apart[:, seen], axis=1)[:, :have])
    assert np.isinf(found.distance[:, have:]).all()
    assert (found.row[:, have:] == -1).all()
    assert (found.photo[:, have:] == -1).all()
    assert np.array_equal(photo_of_row[found.row[:, :have]], found.photo[:, :have])


def test_a_descriptor_that_only_hidden_photos_know_is_given_up(monkeypatch):
    themap = a_map([200, 200, 3], gone=set(), seed=0)
    looked_up = []
    search = themap.search.search
    monkeypatch.setattr(themap.search, "search", lambda d, k: looked_up.append((len(d), k)) or search(d, k))
    monkeypatch.setattr(module, "_MOST_NEIGHBOURS", 64)
    candidates(themap, themap.segments[0].descriptors[:20], k=1, hide={10, 20})
    assert max(k for _, k in looked_up) == 64
    assert [n for n, _ in looked_up] == sorted((n for n, _ in looked_up), reverse=True)


def test_a_whole_map_is_searched_once_for_just_what_is_wanted(monkeypatch):
    themap = a_map([20, 20], gone=set(), seed=0)
    looked_up = []
    search = themap.search.search
    monkeypatch.setattr(themap.search, "search", lambda d, k: looked_up.append(k) or search(d, k))
    candidates(themap, themap.segments[0].descriptors[:5], k=3)
    assert looked_up == [3]


def test_rows_are_looked_up_across_segments():
    themap = a_map([2, 3, 4, 1], gone={1}, seed=3)
    every_xy = np.concatenate([s.xy for s in themap.segments])
    every_angle = np.concatenate([s.angle for s in themap.segments])
    rows = np.array([[0, 9, 4], [5, 2, -1]])
    assert np.array_equal(themap.keypoint_xy(rows)[rows >= 0], every_xy[rows[rows >= 0]])
    assert np.array_equal(themap.keypoint_angle(rows)[rows >= 0], every_angle[rows[rows >= 0]])
    assert themap.photo_of_row(rows).tolist() == [[2, 0, -1], [1, -1, -1]]


def test_photos_are_taken_out_of_their_segment():
    themap = a_map([2, 3, 4, 1], gone={1}, seed=3)
    features = themap.features(1)
    assert features is not None
    assert np.array_equal(features.xy, themap.segments[1].xy[:4])
    assert (len(themap.features(0)), len(themap.features(2))) == (1, 2)
    assert [themap.photo_size(i) for i in range(3)] == [(101, 50), (100, 50), (100, 50)]


def test_a_photo_without_features_has_none():
    themap = a_map([2, 3], gone=set(), seed=3)
    without = IndexedMap(
        ids=np.array([1, 2, 3]),
        position=np.zeros((3, 2)),
        fov_deg=np.full(3, np.nan),
        segments=themap.segments,
        photo_of_entry=np.array([0, 2]),
        search=themap.search,
        place_radius_px=1.0,
    )
    assert without.features(1) is None
    with pytest.raises(IndexError, match="photo 1"):
        without.photo_size(1)
