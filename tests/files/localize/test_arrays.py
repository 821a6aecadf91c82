"""The container of arrays: round trip, memory map, damage."""

import errno
import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from webapp.errors import IndexDamaged, StorageError
from webapp.files.localize.arrays import read_arrays, write_arrays

DTYPES = ["u1", "<i4", "<i8", "<f4", "<f8", "?"]

ARRAYS = st.dictionaries(
    st.text(max_size=12),
    st.sampled_from(DTYPES).flatmap(
        lambda d: hnp.arrays(np.dtype(d), hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=9))
    ),
    max_size=5,
)
META = st.dictionaries(
    st.text(max_size=8), st.integers() | st.text(max_size=30) | st.lists(st.text(), max_size=3), max_size=4
)


@settings(max_examples=60, deadline=None)
@given(arrays=ARRAYS, meta=META, mapped=st.booleans())
def test_what_is_written_is_read(tmp_path_factory, arrays, meta, mapped):
    path = tmp_path_factory.mktemp("arrays") / "a"
    write_arrays(path, arrays, meta=meta)
    read, read_meta = read_arrays(path, mapped=mapped)
    assert read_meta == meta
    assert list(read) == list(arrays)
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype
        assert read[name].shape == array.shape
        assert read[name].tobytes() == array.tobytes()


def written(tmp_path, **arrays):
    path = tmp_path / "a"
    write_arrays(path, arrays or {"x": np.arange(1000)}, meta={"who": "me"})
    return path


def test_arrays_are_mapped_aligned_and_read_only(tmp_path):
    path = written(tmp_path, a=np.ones(3, np.uint8), b=np.arange(5.0))
    read, _ = read_arrays(path)
    for array in read.values():
        assert array.ctypes.data % 64 == 0
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 7


def test_columns_of_a_table_are_written_in_order(tmp_path):
    table = np.arange(12).reshape(3, 4)
    read, _ = read_arrays(written(tmp_path, column=table[:, 1], turned=table.T))
    assert read["column"].tolist() == [1, 5, 9]
    assert read["turned"].tolist() == table.T.tolist()


def test_the_name_is_the_hash_of_the_content(tmp_path):
    template = tmp_path / "{hash}.features"
    one = write_arrays(template, {"x": np.arange(3)}, meta={})
    again = write_arrays(template, {"x": np.arange(3)}, meta={})
    other = write_arrays(template, {"x": np.arange(3) + 1}, meta={})
    assert one == again != other
    assert {p.name for p in tmp_path.iterdir()} == {f"{one}.features", f"{other}.features"}


@pytest.mark.parametrize("length", [0, 1, 7, 8, 15, 16, 40, 700, 4000])
def test_a_cut_file_is_damaged(tmp_path, length):
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(IndexDamaged) as damaged:
        read_arrays(path)
    assert damaged.value.where == str(path)
    assert "expmap build" in str(damaged.value.hint)


def test_a_lengthened_or_missing_or_other_file_is_damaged(tmp_path):
    path = written(tmp_path)
    path.write_bytes(path.read_bytes() + b"more")
    with pytest.raises(IndexDamaged):
        read_arrays(path)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(5000))
    with pytest.raises(IndexDamaged, match="not a file of arrays"):
        read_arrays(path)
    with pytest.raises(IndexDamaged, match="No such file"):
        read_arrays(tmp_path / "none")
    with pytest.raises(IndexDamaged):
        read_arrays(tmp_path)


@settings(max_examples=150, deadline=None)
@given(at=st.integers(0, 16 + 260), byte=st.integers(0, 255))
def test_a_changed_header_never_reads_outside_the_file(tmp_path_factory, at, byte):
    path = tmp_path_factory.getbasetemp() / "changed-header"
    write_arrays(path, {"x": np.arange(100), "y": np.ones((4, 5), np.float32)}, meta={"who": "me"})
    data = bytearray(path.read_bytes())
    data[at] = byte
    path.write_bytes(data)
    try:
        read, _ = read_arrays(path)
    except IndexDamaged:
        return
    for array in read.values():
        array.tobytes()


@pytest.mark.parametrize(
    "header",
    [
        [],
        {},
        {"bytes": 4096, "meta": {}},
        {"bytes": 4096, "meta": {}, "arrays": [7]},
        {"bytes": 4096, "meta": 3, "arrays": []},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "<f4", "shape": [9999], "offset": 64}]},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "|O", "shape": [2], "offset": 64}]},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "?!", "shape": [2], "offset": 64}]},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "u1", "shape": [2], "offset": -64}]},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "u1", "shape": [-1], "offset": 64}]},
        {"bytes": 4096, "meta": {}, "arrays": [{"name": "x", "dtype": "u1", "shape": ["a"], "offset": 64}]},
    ],
)
def test_odd_headers_are_damage(tmp_path, header):
    path = tmp_path / "a"
    text = json.dumps(header).encode()
    path.write_bytes((b"EXPMAP1\n" + len(text).to_bytes(8, "little") + text).ljust(4096, b"\0"))
    with pytest.raises(IndexDamaged):
        read_arrays(path)


def test_any_changed_byte_is_damage_or_does_not_matter(tmp_path):
    path = written(tmp_path, x=np.arange(9), y=np.linspace(0, 1, 5))
    whole, data = read_arrays(path, mapped=False), path.read_bytes()
    found = 0
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        try:
            read, meta = read_arrays(path, verify=True)
        except IndexDamaged:
            found += 1
            continue
        assert meta == whole[1]
        assert {name: array.tolist() for name, array in read.items()} == {
            name: array.tolist() for name, array in whole[0].items()
        }
    assert found > sum(array.nbytes for array in whole[0].values())


def test_a_full_disk_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="free some space"):
        written(tmp_path)
    assert list(tmp_path.iterdir()) == []
