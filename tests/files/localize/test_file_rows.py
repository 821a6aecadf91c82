"""Rows read from a file, compared with the same array in memory."""

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from webapp.core.retrieval.engines.vlad import Codebook
from webapp.errors import IndexDamaged
from webapp.files.localize.arrays import read_arrays, write_arrays
from webapp.files.localize.features import read_codebook, read_signatures, write_codebook, write_signatures
from webapp.threads import in_threads


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.integers(0, 3000),
    wide=st.integers(1, 40),
    wanted=st.lists(st.integers(0, 2999), max_size=40),
    ends=st.tuples(st.integers(-10, 3010), st.integers(-10, 3010)),
)
def test_as_an_array_in_memory(tmp_path, rows, wide, wanted, ends):
    whole = np.random.default_rng(rows).integers(0, 1000, (rows, wide)).astype(np.float32)
    write_arrays(tmp_path / "a", {"small": np.arange(7), "large": whole}, meta={})
    arrays, _ = read_arrays(tmp_path / "a", in_file=["large"])
    large = arrays["large"]
    assert arrays["small"].tolist() == list(range(7))
    assert (len(large), large.shape, large.ndim) == (rows, whole.shape, 2)
    assert np.array_equal(large[slice(*ends)], whole[slice(*ends)])
    some = np.array([w for w in wanted if w < rows], np.int64)
    assert np.array_equal(large[some], whole[some])


@pytest.mark.skipif(sys.platform == "win32", reason="a file that is open cannot be deleted there")
def test_a_file_that_was_deleted_is_still_read_by_all_threads(tmp_path):
    whole = np.arange(200_000, dtype=np.int64).reshape(-1, 4)
    write_arrays(tmp_path / "a", {"large": whole}, meta={})
    large = read_arrays(tmp_path / "a", in_file=["large"])[0]["large"]
    (tmp_path / "a").unlink()
    parts = in_threads(lambda i: large[1000 * i : 1000 * (i + 1)], range(50))
    assert np.array_equal(np.concatenate(parts), whole)


def test_a_file_that_is_cut_off_afterwards_is_damage(tmp_path):
    write_arrays(tmp_path / "a", {"large": np.zeros((1000, 8))}, meta={})
    large = read_arrays(tmp_path / "a", in_file=["large"])[0]["large"]
    with (tmp_path / "a").open("r+b") as file:
        file.truncate(5000)
    with pytest.raises(IndexDamaged, match="truncated") as caught:
        large[900:]
    assert caught.value.where == str(tmp_path / "a")
    assert "expmap build" in caught.value.hint


def test_codebooks_and_signatures_come_back(tmp_path):
    rng = np.random.default_rng(0)
    codebook = Codebook(rng.random((64, 16), np.float32), rng.random((64, 16), np.float32))
    signatures = rng.integers(0, 256, (5, codebook.signature_bytes), np.uint8)
    name = write_codebook(tmp_path / "{hash}.codebook", codebook)
    write_signatures(tmp_path / "s.vlad", signatures)
    there = read_codebook(tmp_path / f"{name}.codebook")
    assert np.array_equal(there.centres, codebook.centres)
    assert np.array_equal(there.mean, codebook.mean)
    assert np.array_equal(read_signatures(tmp_path / "s.vlad", there), signatures)
    with pytest.raises(IndexDamaged, match="codebook"):
        read_codebook(tmp_path / "s.vlad")
    with pytest.raises(IndexDamaged, match="signatures"):
        read_signatures(tmp_path / f"{name}.codebook", there)
