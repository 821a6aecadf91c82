"""Signatures of photos, and the two-stage search compared with exhaustive search."""

import numpy as np
import pytest

from webapp.core.retrieval.engines import twostage, vlad
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.twostage import TwoStage
from webapp.core.retrieval.engines.types import Segment, bytes_in_memory, tier_for
from webapp.core.retrieval.indexed import IndexedMap, candidates

WIDTH = 32


def scenes(count: int, *, seed: int) -> list[np.ndarray]:
    """Return descriptors of photos, some distinctive and some common to all."""
    rng = np.random.default_rng(seed)
    everywhere = rng.integers(0, 256, (20, WIDTH))
    shown = []
    for _ in range(count):
        rows = np.concatenate([rng.integers(0, 256, (60, WIDTH)), everywhere])
        shown.append((rows + rng.normal(0.0, 3.0, rows.shape)).clip(0, 255).astype(np.uint8))
    return shown


def seen_again(rows: np.ndarray, *, seed: int) -> np.ndarray:
    """Return most of a photo's descriptors again, and some new ones."""
    rng = np.random.default_rng(seed)
    kept = rows[rng.permutation(len(rows))[:50]] + rng.normal(0.0, 6.0, (50, rows.shape[1]))
    return np.concatenate([kept, rng.integers(0, 256, (20, rows.shape[1]))]).clip(0, 255).astype(np.uint8)


def segment_of(photos: list[np.ndarray]) -> Segment:
    rows = sum(map(len, photos))
    return Segment(
        content=[f"{i:064x}" for i in range(len(photos))],
        first=np.cumsum([0, *map(len, photos)], dtype=np.int64),
        xy=np.zeros((rows, 2), np.float32),
        size=np.ones(rows, np.float32),
        angle=np.zeros(rows, np.float32),
        descriptors=np.concatenate([np.zeros((0, WIDTH), np.uint8), *photos]),
        photo_size=np.full((len(photos), 2), 100, np.int32),
        fov_deg=np.full(len(photos), 60.0),
    )


def searching(*parts: list[np.ndarray]) -> TwoStage:
    codebook = vlad.train([p for part in parts for p in part if len(p)])
    signatures = [np.array([vlad.signature(codebook, p) for p in part]) for part in parts]
    return TwoStage(codebook, signatures, segments=[segment_of(part) for part in parts])


def test_the_photo_that_is_seen_again_is_named_first():
    photos = scenes(400, seed=1)
    codebook = vlad.train(photos)
    signatures = [np.array([vlad.signature(codebook, p) for p in photos])]
    assert signatures[0].shape == (400, codebook.signature_bytes)
    named = [
        vlad.most_similar(
            codebook,
            signatures,
            descriptors=seen_again(photos[i], seed=i),
            visible=np.ones(400, bool),
            most=10,
        )
        for i in range(0, 400, 10)
    ]
    assert all(len(n) == len(set(n)) == 10 for n in named)
    first = [int(n[0]) == i for n, i in zip(named, range(0, 400, 10), strict=True)]
    assert np.mean(first) > 0.9
    assert all(i in n for n, i in zip(named, range(0, 400, 10), strict=True))


def test_a_repeated_pattern_counts_once():
    centres = np.random.default_rng(2).integers(0, 256, (8, WIDTH)).astype(np.float32)
    rows = scenes(1, seed=3)[0]
    repeated = np.concatenate([rows, np.repeat(rows[:1], 500, axis=0)])
    once, often = vlad.aggregate(centres, rows), vlad.aggregate(centres, repeated)
    assert np.allclose(np.linalg.norm(once[once.any(1)], axis=1), 1.0, atol=1e-5)
    changed = np.abs(once - often).max(axis=1) > 1e-3
    assert changed.sum() == 1  # only the word of the repeated pattern
    assert np.abs(often).max() <= 1.0


@pytest.mark.parametrize("segments", [1, 3])
def test_neighbours_are_those_of_an_exact_search(segments):
    photos = scenes(20, seed=4)  # few enough for exhaustive comparison
    parts = [photos[i::segments] for i in range(segments)]
    search = searching(*parts)
    rows = np.concatenate([p for part in parts for p in part])
    query = seen_again(parts[-1][0], seed=5)
    found = search.search_among(query, 1, visible=np.ones(20, bool))
    exact = BruteForce([rows], "l2").search(query, 1)
    assert np.allclose(found.distance, exact.distance, atol=0.05)
    named = found.row[:, 0] >= 0
    assert named.mean() > 0.7  # the others are closer to another descriptor of the query
    assert np.mean(found.row[named] == exact.row[named]) > 0.95
    several = search.search_among(query, 6, visible=np.ones(20, bool))
    assert (np.diff(several.distance, axis=1) >= 0).all()
    photo = np.where(several.row >= 0, several.row // 80, -1)
    named = [[p for p in row if p >= 0] for row in photo.tolist()]
    assert all(len(set(row)) == len(row) for row in named)  # one per photo
    assert np.isfinite(several.distance).all()


def test_a_neighbour_that_is_nearer_to_another_descriptor_is_none():
    photos = scenes(8, seed=12)
    query = np.vstack([photos[3][:40], photos[3][:40] ^ 1])  # each seen twice, once exactly
    found = searching(photos).search_among(query, 3, visible=np.ones(8, bool))
    assert (found.row[:40, 0] // 80 == 3).all()
    assert (found.row[40:, 0] == -1).all()
    assert np.isfinite(found.distance[:, 0]).all()


def test_recall_among_many_photos_that_are_not_all_compared(monkeypatch):
    monkeypatch.setattr(twostage, "_NAMED", 20)
    monkeypatch.setattr(twostage, "_COMPARED", 8)
    photos = scenes(300, seed=6)
    search = searching(photos[:120], photos[120:])
    right = []
    for i in range(0, 300, 15):
        found = search.search_among(seen_again(photos[i], seed=i), 3, visible=np.ones(300, bool))
        assert np.isinf(found.distance).sum() == 0
        right.append(np.mean(found.row[:50, 0] // 80 == i))
    assert np.mean(right) > 0.6


def test_photos_that_are_gone_or_hidden_are_never_named_and_those_added_are():
    photos = scenes(30, seed=7)
    search = searching(photos[:20], photos[20:])
    themap = IndexedMap(
        ids=np.arange(29) * 10,
        position=np.random.default_rng(0).random((29, 2)) * 100.0,
        fov_deg=np.full(29, 60.0),
        segments=[segment_of(photos[:20]), segment_of(photos[20:])],
        photo_of_entry=np.array([*range(5), -1, *range(5, 29)]),  # entry 5 is a tombstone
        search=search,
        place_radius_px=1.0,
    )
    gone, there, added = photos[5], photos[8], photos[25]
    assert 5 not in candidates(themap, gone, k=4).row // 80
    assert (candidates(themap, there, k=1).photo == 7).mean() > 0.7
    assert (candidates(themap, added, k=1).photo == 24).mean() > 0.7
    assert not (candidates(themap, there, k=4, hide={70}).photo == 7).any()
    nothing = candidates(themap, there, k=2, hide=set(range(0, 300, 10)))
    assert (nothing.row == -1).all()
    assert np.isinf(nothing.distance).all()


def test_photos_and_queries_without_anything_are_no_trouble():
    photos = [*scenes(6, seed=8), np.zeros((0, WIDTH), np.uint8)]
    search = searching(photos)
    found = search.search_among(photos[2], 9, visible=np.ones(7, bool))
    assert np.mean(found.row[:, 0] // 80 == 2) > 0.7
    assert np.isfinite(found.distance[:, :6]).all()
    assert search.search_among(photos[6], 3, visible=np.ones(7, bool)).row.shape == (0, 3)
    assert searching([photos[0][:3]]).search_among(photos[0][:3], 1, visible=np.ones(1, bool)).row[2] == 2


@pytest.mark.parametrize("visible", [1, 2, 5])
def test_where_few_photos_may_be_named_each_gives_more_neighbours(visible):
    photos = scenes(12, seed=10)
    query = seen_again(photos[0], seed=11)
    found = searching(photos).search_among(query, 11, visible=np.arange(12) < visible)
    exact = BruteForce([np.concatenate(photos[:visible])], "l2").search(query, 11)
    assert (np.diff(found.distance[:, :6], axis=1) >= 0).all()
    assert np.isfinite(found.distance[:, :6]).all()
    assert np.allclose(found.distance[:, 0], exact.distance[:, 0], atol=0.05)
    if visible == 1:
        assert np.allclose(found.distance[:, :6], exact.distance[:, :6], atol=0.05)
    few = searching([photos[0][:3]]).search_among(query, 11, visible=np.ones(1, bool))
    assert np.isfinite(few.distance).sum(axis=1).tolist() == [3] * len(query)


def test_training_is_the_same_every_time():
    photos = scenes(50, seed=9)
    one, two = vlad.train(photos), vlad.train(photos)
    assert np.array_equal(one.centres, two.centres)
    assert np.array_equal(one.mean, two.mean)


def test_the_way_of_searching_follows_from_the_memory_there_is():
    def chosen(rows: int, memory_mb: float) -> str:
        return tier_for(rows, width=128, kind="float", memory_mb=memory_mb)

    assert chosen(1_400_000, 500.0) == "ivf"
    assert chosen(100_000_000, 500.0) == "vlad"
    assert chosen(1_400_000, 10.0) == "vlad"
    assert chosen(100, 0.0) == "vlad"
    assert tier_for(10**9, width=32, kind="binary", memory_mb=1.0) == "ivf"  # no signatures of bits
    sizes = [bytes_in_memory(n, width=128, kind="float") for n in (0, 19_999, 30_000 * 40)]
    assert sizes == sorted(sizes)
    assert bytes_in_memory(1000, width=32, kind="binary") > 32_000
