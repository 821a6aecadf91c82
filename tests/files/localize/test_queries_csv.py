import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.errors import TableError, UsageError
from webapp.files.localize import queries_csv


def write(folder: Path, data: bytes) -> Path:
    path = folder / "queries.csv"
    path.write_bytes(data)
    return path


def test_reads_paths_relative_to_the_list_and_float_positions(tmp_path: Path) -> None:
    path = write(tmp_path, "path;x;y\nphotos/a b.jpg;10;20.5\n../ž.jpg;-3;1e2\n".encode())
    first, second = queries_csv.read(path)
    assert first == queries_csv.Query("photos/a b.jpg", tmp_path / "photos/a b.jpg", MapPixel(10, 20.5))
    assert (second.name, second.truth) == ("../ž.jpg", MapPixel(-3, 100))


def test_accepts_mark_crlf_and_blank_end(tmp_path: Path) -> None:
    path = write(tmp_path, b"\xef\xbb\xbfpath;x;y\r\na.jpg;1;2\r\n\r\n  \r\n")
    assert [q.name for q in queries_csv.read(path)] == ["a.jpg"]


@pytest.mark.parametrize(
    ("data", "place", "message"),
    [
        (b"", ":1:1", "header"),
        (b"a.jpg;1;2\n", ":1:1", "header"),
        (b"path;x;y\na.jpg;1\n", ":2:1", "2 columns"),
        (b"path;x;y\na.jpg;1;2\n\nb.jpg;1;2\n", ":3:1", "1 columns"),
        (b"path;x;y\na.jpg;1;2;3\n", ":2:1", "4 columns"),
        (b"path;x;y\n;1;2\n", ":2:1", "path"),
        (b"path;x;y\na.jpg;1;2\nb.jpg;1,5;2\n", ":3:7", "'1,5'"),
        (b"path;x;y\na.jpg;1;\n", ":2:9", "''"),
        (b"path;x;y\na.jpg;nan;2\n", ":2:7", "'nan'"),
        (b"path;x;y\na.jpg;1;1e999\n", ":2:9", "1e999"),
        (b"path;x;y\na.jpg;1;1_0\n", ":2:9", "1_0"),
        (b"path;x;y\n", "queries.csv", "no queries"),
        (b"path;x;y\n\xff.jpg;1;2\n", "queries.csv", "UTF-8"),
    ],
)
def test_refuses_with_line_and_column(tmp_path: Path, data: bytes, place: str, message: str) -> None:
    with pytest.raises(TableError) as error:
        queries_csv.read(write(tmp_path, data))
    assert str(error.value.where).endswith(place)
    assert message in error.value.message
    assert error.value.hint


def test_decimal_comma_is_named_as_the_cause(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="decimal point"):
        queries_csv.read(write(tmp_path, b"path;x;y\na.jpg;1,5;2\n"))


def test_missing_list(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="cannot be read"):
        queries_csv.read(tmp_path / "none.csv")


@given(st.integers(1, 400), st.integers(1, 400))
def test_limit_takes_evenly_spread_items(count: int, limit: int) -> None:
    chosen = queries_csv.select(range(count), limit)
    assert len(chosen) == min(count, limit)
    assert chosen[0] == 0
    steps = {b - a for a, b in itertools.pairwise(chosen)}
    assert steps <= {count // len(chosen), count // len(chosen) + 1}


def test_limit_is_the_floor_of_i_n_over_limit() -> None:
    assert queries_csv.select("abcdefghij", 4) == ["a", "c", "f", "h"]
    assert queries_csv.select("abc", None) == ["a", "b", "c"]
    with pytest.raises(UsageError):
        queries_csv.select("abc", 0)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = write(tmp_path_factory.getbasetemp(), b"path;x;y\n" + data)
    try:
        assert queries_csv.read(path)
    except TableError as error:
        assert error.where


def test_reads_the_real_lists(shared_data: Path) -> None:
    queries = queries_csv.read(shared_data / "getty" / "queries.csv")
    assert len(queries) == 300
    assert all(q.path.is_file() for q in queries)
