"""FLANN and the inverted file against exact search."""

import faiss
import numpy as np
import pytest

from webapp.core.retrieval.engines import ivf
from webapp.core.retrieval.engines.bruteforce import BruteForce
from webapp.core.retrieval.engines.flann import Flann
from webapp.core.retrieval.engines.ivf import InvertedFile, cells_for

KINDS = ("float", "binary")
EXACT = {"float": "l2", "binary": "hamming"}


def descriptors(kind: str, rows: int, *, seed: int) -> np.ndarray:
    """Return descriptors in clusters, like those of photos."""
    rng = np.random.default_rng(seed)
    if kind == "binary":
        centres = np.random.default_rng(99).integers(0, 2, (40, 256), np.uint8)
        bits = centres[rng.integers(0, 40, rows)] ^ (rng.random((rows, 256)) < 0.12)
        return np.packbits(bits.astype(np.uint8), axis=1)
    centres = np.random.default_rng(98).gamma(0.6, 30.0, (40, 128))
    noisy = centres[rng.integers(0, 40, rows)] + rng.normal(0.0, 12.0, (rows, 128))
    return noisy.clip(0, 255).astype(np.uint8)


def varied(rows: np.ndarray, kind: str, *, seed: int) -> np.ndarray:
    """Return the same descriptors with the variation of another photo."""
    rng = np.random.default_rng(seed)
    if kind == "binary":
        return rows ^ np.packbits(rng.random((len(rows), 256)) < 0.03, axis=1)
    return (rows + rng.normal(0.0, 4.0, rows.shape)).clip(0, 255).astype(np.uint8)


def inverted(segments: list[np.ndarray], kind: str) -> InvertedFile:
    every = np.concatenate(segments)
    codebook = ivf.train(every, len(every), kind=kind)
    coded = []
    for segment in segments:
        copy = faiss.clone_binary_index(codebook) if kind == "binary" else faiss.clone_index(codebook)
        ivf.encode(copy, segment)
        coded.append(copy)
    return InvertedFile(coded)


def engine(name: str, segments: list[np.ndarray], kind: str):
    return Flann(segments, kind) if name == "flann" else inverted(segments, kind)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "rows"), [("flann", 6000), ("ivf", 6000), ("ivf", 21_000)])
def test_most_nearest_neighbours_are_found(name, kind, rows):
    held = descriptors(kind, rows, seed=1)
    chosen = np.random.default_rng(2).choice(rows, 300, replace=False)
    query = varied(held[chosen], kind, seed=3)
    found = engine(name, [held], kind).search(query, 5)
    exact = BruteForce([held], EXACT[kind]).search(query, 5)
    assert (exact.row[:, 0] == chosen).mean() > 0.99
    assert (found.row[:, 0] == chosen).mean() > 0.85
    assert found.distance.shape == found.row.shape == (300, 5)
    assert found.distance.dtype == np.float32
    assert found.row.dtype == np.int64
    assert (np.diff(np.where(np.isinf(found.distance), 1e9, found.distance), axis=1) >= 0).all()
    if (name, kind, rows) != ("ivf", "float", 21_000):  # only large maps are compressed
        right = found.row[:, 0] == chosen
        assert np.allclose(found.distance[right, 0], exact.distance[right, 0], rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["flann", "ivf"])
def test_several_segments_answer_as_one(name, kind):
    held = descriptors(kind, 5000, seed=4)
    query = varied(held[::25], kind, seed=5)
    one = engine(name, [held], kind).search(query, 4)
    parts = [held[:1200], held[1200:1200], held[1200:1300], held[1300:]]
    several = engine(name, parts, kind).search(query, 4)
    assert np.array_equal(one.distance, several.distance)
    assert (one.row == several.row).mean() > 0.99  # rows at equal distances may be swapped
    assert np.array_equal(one.row[:, 0], several.row[:, 0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["flann", "ivf"])
@pytest.mark.parametrize("rows", [1, 2, 39, 90, 700])
def test_small_maps_are_searched_too(name, kind, rows):
    held = descriptors(kind, rows, seed=6)
    found = engine(name, [held], kind).search(held, 3)
    assert found.distance.shape == found.row.shape == (rows, 3)
    assert (found.row >= -1).all()
    assert (found.row < rows).all()
    assert np.array_equal(found.row == -1, np.isinf(found.distance))
    # Each descriptor finds itself: small maps are not compressed.
    assert (found.row[:, 0] == np.arange(rows)).mean() > 0.95
    assert (found.distance[found.row[:, 0] == np.arange(rows), 0] == 0.0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_index_finds_nothing(kind):
    query = descriptors(kind, 3, seed=7)
    for search in (Flann([], kind), Flann([query[:0]], kind), InvertedFile([])):
        found = search.search(query, 2)
        assert found.row.tolist() == [[-1, -1]] * 3
        assert np.isinf(found.distance).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["flann", "ivf"])
def test_a_query_without_descriptors_has_no_neighbours(name, kind):
    held = descriptors(kind, 100, seed=8)
    found = engine(name, [held], kind).search(held[:0], 3)
    assert found.row.shape == found.distance.shape == (0, 3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_training_is_the_same_on_any_number_of_cores(kind):
    sample = descriptors(kind, 22_000, seed=9)
    serialise = faiss.serialize_index_binary if kind == "binary" else faiss.serialize_index
    before, trained = faiss.omp_get_max_threads(), []
    try:
        for threads in (1, 3):
            faiss.omp_set_num_threads(threads)
            trained.append(serialise(ivf.train(sample, len(sample), kind=kind)).tobytes())
    finally:
        faiss.omp_set_num_threads(before)
    assert trained[0] == trained[1]


def test_cells_grow_with_the_map_and_have_enough_samples():
    counts = [cells_for(n) for n in (0, 1, 40, 1000, 10**5, 10**6, 10**8, 10**10)]
    assert counts == sorted(counts)
    assert counts[:3] == [1, 1, 1]
    assert counts[-1] == 65_536
    assert all(cells_for(n) * ivf.SAMPLE_PER_CELL <= max(n, 40) for n in (40, 1000, 10**5, 10**7))


@pytest.mark.parametrize("kind", KINDS)
def test_flann_is_the_same_every_time(kind):
    held = descriptors(kind, 3000, seed=10)
    query = varied(held[::10], kind, seed=11)
    one = Flann([held], kind).search(query, 3)
    Flann([held[:90]], kind)  # uses up random numbers
    two = Flann([held], kind).search(query, 3)
    assert np.array_equal(one.row, two.row)
    assert np.array_equal(one.distance, two.distance)


@pytest.mark.slow
@pytest.mark.parametrize("width", [64, 128])
def test_among_many_cells_nearly_the_same_are_searched(width):
    rows = 64_000
    held = np.ascontiguousarray(descriptors("float", rows, seed=1)[:, :width])
    codebook = ivf.train(held, rows, kind="float")
    assert codebook.nlist > 1000
    query = varied(held[::200], "float", seed=3).astype(np.float32)
    _, exact = codebook.quantizer.search(query, 4)
    _, found = ivf._cell_search(codebook).search(query, 4)
    same = [len(set(a) & set(b)) / 4 for a, b in zip(exact, found, strict=True)]
    assert np.mean(same) > 0.93
    assert (exact[:, 0] == found[:, 0]).mean() > 0.97
