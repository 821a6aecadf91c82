"""Brute force against plain numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.core.retrieval.engines import bruteforce
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.types import Neighbours, merge_nearest

NORMS = ("l1", "l2", "hamming", "hamming2")


def all_distances(query: np.ndarray, rows: np.ndarray, norm: str) -> np.ndarray:
    a, b = query[:, None].astype(np.int64), rows[None].astype(np.int64)
    if norm == "l1":
        return np.abs(a - b).sum(2).astype(np.float64)
    if norm == "l2":
        return np.sqrt(((a - b) ** 2).sum(2))
    bits = np.unpackbits((query[:, None] ^ rows[None]), axis=2)
    if norm == "hamming":
        return bits.sum(2).astype(np.float64)
    pairs = bits[..., ::2] | bits[..., 1::2]
    return pairs.sum(2).astype(np.float64)


def check(found: Neighbours, query: np.ndarray, rows: np.ndarray, *, norm: str, k: int) -> None:
    """Compare with numpy; rows at equal distances may be swapped."""
    every = all_distances(query, rows, norm)
    have = min(k, len(rows))
    assert found.distance.shape == found.row.shape == (len(query), k)
    assert found.distance.dtype == np.float32
    assert found.row.dtype == np.int64
    assert np.allclose(found.distance[:, :have], np.sort(every, axis=1)[:, :have], rtol=1e-6)
    assert np.isinf(found.distance[:, have:]).all()
    assert (found.row[:, have:] == -1).all()
    named = np.take_along_axis(every, found.row[:, :have], 1)
    assert np.allclose(named, found.distance[:, :have], rtol=1e-6)
    assert all(len(set(r)) == have for r in found.row[:, :have].tolist())


@pytest.mark.parametrize("norm", NORMS)
@settings(max_examples=25, deadline=None)
@given(
    sizes=st.lists(st.integers(0, 30), min_size=0, max_size=4),
    queries=st.integers(0, 9),
    k=st.integers(1, 12),
    block=st.sampled_from([1, 7, 65_536]),
    seed=st.integers(0, 2**32 - 1),
)
def test_as_numpy_over_any_segments_and_blocks(norm, sizes, queries, k, block, seed):
    rng = np.random.default_rng(seed)
    segments = [rng.integers(0, 256, (n, 32), np.uint8) for n in sizes]
    query = rng.integers(0, 256, (queries, 32), np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bruteforce, "_BLOCK_ROWS", block)
        found = BruteForce(segments, norm).search(query, k)
    rows = np.concatenate([np.zeros((0, 32), np.uint8), *segments])
    check(found, query, rows, norm=norm, k=k)


@pytest.mark.parametrize("norm", NORMS)
def test_extreme_descriptors_are_exact_and_a_copy_is_at_distance_zero(norm):
    rng = np.random.default_rng(1)
    rows = np.concatenate(
        [
            np.zeros((1, 128), np.uint8),
            np.full((1, 128), 255, np.uint8),
            rng.integers(0, 256, (300, 128), np.uint8),
        ]
    )
    found = BruteForce([rows[:100], rows[100:]], norm).search(rows, 3)
    check(found, rows, rows, norm=norm, k=3)
    assert (found.distance[:, 0] == 0.0).all()
    assert found.row[:, 0].tolist() == list(range(len(rows)))


def test_memory_mapped_segments_are_searched_as_they_are(tmp_path):
    rows = np.random.default_rng(2).integers(0, 256, (50, 128), np.uint8)
    rows.tofile(tmp_path / "rows")
    mapped = np.memmap(tmp_path / "rows", np.uint8, "r", shape=(50, 128))
    assert BruteForce([mapped], "l2").search(rows[7:8], 1).row.tolist() == [[7]]


def test_merging_keeps_the_nearest_and_fills_up_with_nothing():
    a = Neighbours(np.array([[1.0, 4.0]], np.float32), np.array([[10, 11]]))
    b = Neighbours(np.array([[0.5, 4.0]], np.float32), np.array([[20, 21]]))
    merged = merge_nearest([a, b], 3)
    assert merged.distance.tolist() == [[0.5, 1.0, 4.0]]
    assert merged.row.tolist() == [[20, 10, 11]]  # of rows at equal distances, that of the first part
    longer = merge_nearest([a], 3)
    assert longer.distance.tolist() == [[1.0, 4.0, np.inf]]
    assert longer.row.tolist() == [[10, 11, -1]]
