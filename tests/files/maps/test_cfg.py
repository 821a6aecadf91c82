"""The reader and writer of map files."""

import re
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import CfgError, MapError
from webapp.files.maps.cfg import format_cfg, parse_cfg, read_cfg
from webapp.files.maps.cfg_scan import scan

CORPUS = Path(__file__).parent / "cfg_corpus"
EXPECTED = [
    line.split(" ", 1) for line in (CORPUS / "expected.txt").read_text("utf-8").splitlines() if line[0] != "#"
]
SIZES = st.integers(1, 5000)
NAMES = st.text(min_size=1, max_size=30).filter(lambda name: name_problem(name) is None)


@st.composite
def maps(draw: st.DrawFn) -> Map:
    image = SatelliteImage(draw(NAMES), draw(SIZES), draw(SIZES))
    ids = draw(st.lists(st.integers(0, 2**31 - 1), unique=True, max_size=6))
    photos = tuple(
        Experience(
            id,
            draw(NAMES),
            MapPixel(float(draw(st.integers(0, image.width))), float(draw(st.integers(0, image.height)))),
        )
        for id in ids
    )
    return Map(image, photos, next_id=max(ids, default=-1) + 1)


@st.composite
def odd_spellings(draw: st.DrawFn) -> bytes:
    """Return a valid file with all tolerated variations."""
    rows = [row.split(";") for row in format_cfg(draw(maps())).decode().split("\n")[:-1]]
    space = st.text(" ", max_size=2)
    end = st.sampled_from(["\n", "\r\n"])
    text = "".join(";".join(draw(space) + cell + draw(space) for cell in row) + draw(end) for row in rows)
    text = draw(st.sampled_from([text, text.rstrip("\r\n")])) + draw(st.sampled_from(["", "\n", "\r\n \n  "]))
    return draw(st.sampled_from([b"", b"\xef\xbb\xbf"])) + text.encode()


@pytest.mark.parametrize(("name", "outcome"), EXPECTED, ids=[name for name, _ in EXPECTED])
def test_corpus(name: str, outcome: str) -> None:
    data = (CORPUS / name).read_bytes()
    if outcome == "ok":
        document = parse_cfg(data)
        assert format_cfg(document.map, like=document) == data
        assert parse_cfg(format_cfg(document.map)).map == document.map
        return
    code, line, column = outcome.split(" ")
    with pytest.raises(CfgError) as caught:
        parse_cfg(data, where=name)
    assert (caught.value.line, caught.value.column) == (int(line), int(column))
    assert caught.value.where == f"{name}:{line}:{column}"
    assert caught.value.hint
    assert code in {finding.code for finding in scan(data).faults if finding.line == int(line)} or code in (
        "duplicate-id",
        "position-outside-image",
    )


def test_corpus_is_complete() -> None:
    assert sorted(name for name, _ in EXPECTED) == sorted(path.name for path in CORPUS.glob("*.cfg"))
    assert len(EXPECTED) >= 40


@given(maps())
def test_written_map_is_read_back(map_: Map) -> None:
    data = format_cfg(map_)
    document = parse_cfg(data)
    assert document.map == map_
    assert format_cfg(document.map) == format_cfg(document.map, like=document) == data
    assert data.endswith(b"\n") and not data.endswith(b"\n\n") and b"\r" not in data


@given(odd_spellings())
def test_tolerated_spelling_survives(data: bytes) -> None:
    document = parse_cfg(data)
    assert format_cfg(document.map, like=document) == data
    canonical = format_cfg(document.map)
    assert parse_cfg(canonical).map == document.map
    assert format_cfg(parse_cfg(canonical).map) == canonical


@given(data=st.data(), base=st.sampled_from([(CORPUS / name).read_bytes()[:200] for name, _ in EXPECTED]))
def test_mutations_raise_nothing_but_cfg_errors(data: st.DataObject, base: bytes) -> None:
    mutated = bytearray(base)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(mutated)))
        size = data.draw(st.integers(0, 3))
        piece = data.draw(
            st.binary(max_size=3) | st.sampled_from([b";", b"\n", b"\r\n", b",", b"9", b"\xc5", b" "])
        )
        mutated[at : at + size] = piece
    check_total(bytes(mutated))


@given(st.binary(max_size=60))
def test_any_bytes_raise_nothing_but_cfg_errors(data: bytes) -> None:
    check_total(data)


@given(st.text(max_size=40))
def test_text_is_read_as_its_bytes(text: str) -> None:
    try:
        read = parse_cfg(text)
    except CfgError:
        with pytest.raises(CfgError):
            parse_cfg(text.encode("utf-8", "surrogatepass"))
    else:
        assert read == parse_cfg(text.encode())


def check_total(data: bytes) -> None:
    """Check that any bytes give a document that is written back identically, or an error with a position."""
    pieces = scan(data)
    lines = data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "surrogateescape").split("\n")
    for finding in pieces.faults:
        assert 1 <= finding.line <= len(lines) and 1 <= finding.column <= len(lines[finding.line - 1]) + 1
        assert finding.message and finding.fix
        assert not re.search(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]", finding.message + finding.fix)
    try:
        document = parse_cfg(data)
    except CfgError as error:
        assert 1 <= error.line <= len(lines) and 1 <= error.column <= len(lines[error.line - 1]) + 1
    else:
        assert not pieces.faults
        assert format_cfg(document.map, like=document) == data


@pytest.mark.parametrize("folder", ["getty", "gardens_point"])
def test_real_map_round_trip(shared_data: Path, folder: str) -> None:
    original = shared_data / folder / "map.cfg"
    document = read_cfg(original)
    assert len(document.map.experiences) == {"getty": 1400, "gardens_point": 200}[folder]
    assert format_cfg(document.map, like=document) == original.read_bytes()
    assert format_cfg(document.map) == original.read_bytes()


@pytest.mark.parametrize(
    ("exact", "whole"), [(0.5, 1), (0.49, 0), (1.5, 2), (2.5, 3), (2.4999, 2), (9.99, 10)]
)
def test_positions_are_rounded_half_up(exact: float, whole: int) -> None:
    map_ = Map(SatelliteImage("s.png", 10, 10), (Experience(0, "a.jpg", MapPixel(exact, exact)),))
    assert format_cfg(map_) == f"s.png;10;10\n0;a.jpg;{whole};{whole}\n".encode()


def test_edited_document_keeps_its_style() -> None:
    document = parse_cfg(b"\xef\xbb\xbfs.png;10;10\r\n 0;a.jpg; 1;1\r\n1;b.jpg;2;2\r\n2;c.jpg;3;3")
    a, _, c = document.map.experiences
    moved = Experience(1, "b.jpg", MapPixel(4.6, 2.0))
    new = Experience(7, "d.jpg", MapPixel(5.0, 5.0))
    edited = Map(document.map.satellite, (a, moved, c, new))
    assert format_cfg(edited, like=document) == (
        b"\xef\xbb\xbfs.png;10;10\r\n 0;a.jpg; 1;1\r\n1;b.jpg;5;2\r\n2;c.jpg;3;3\r\n7;d.jpg;5;5"
    )


@pytest.mark.parametrize(
    ("experience", "words"),
    [
        (Experience(0, "a;b.jpg", MapPixel(1, 1)), "contains ';'"),
        (Experience(0, "a\nb.jpg", MapPixel(1, 1)), "line break"),
        (Experience(0, " a.jpg", MapPixel(1, 1)), "begins or ends with a space"),
        (Experience(0, "", MapPixel(1, 1)), "empty"),
        (Experience(0, "../a.jpg", MapPixel(1, 1)), r"'\.\.'"),
        (Experience(0, "a\udcff.jpg", MapPixel(1, 1)), "UTF-8"),
        (Experience(-1, "a.jpg", MapPixel(1, 1)), "id -1"),
        (Experience(2**31, "a.jpg", MapPixel(1, 1)), "id 2147483648"),
        (Experience(3, "a.jpg", MapPixel(1, 1)), "used twice"),
        (Experience(0, "a.jpg", MapPixel(10.2, 1)), "outside"),
        (Experience(0, "a.jpg", MapPixel(float("nan"), 1)), "outside"),
    ],
)
def test_what_a_cfg_cannot_hold_is_not_written(experience: Experience, words: str) -> None:
    map_ = Map(SatelliteImage("s.png", 10, 10), (Experience(3, "z.jpg", MapPixel(1, 1)), experience))
    with pytest.raises(MapError, match=words) as caught:
        format_cfg(map_)
    assert caught.value.hint


def test_an_error_reads_as_one_line_with_the_fix() -> None:
    with pytest.raises(CfgError) as caught:
        parse_cfg("s.png;100;100\n0;a.jpg;20,5;20\n", where="map.cfg")
    assert str(caught.value) == (
        "map.cfg:2:9: x = '20,5' has a decimal comma: pixels are whole numbers (write 0;a.jpg;21;20)"
    )


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="map file not found"):
        read_cfg(tmp_path / "map.cfg")
    with pytest.raises(MapError, match="cannot be read"):
        read_cfg(tmp_path)


@given(
    lines=st.lists(st.sampled_from(["0;a.jpg;1;1", "ž"]), max_size=3), bom=st.booleans(), crlf=st.booleans()
)
def test_offset_of_a_bad_byte(lines: list[str], bom: bool, crlf: bool) -> None:
    end = "\r\n" if crlf else "\n"
    before = (b"\xef\xbb\xbf" if bom else b"") + end.join([*lines, "9;ž"]).encode()
    (fault,) = [f for f in scan(before + b"\xe9.jpg;1;1").faults if f.code == "not-utf-8"]
    assert f"offset {len(before)} " in fault.message
    assert (fault.line, fault.column) == (len(lines) + 1, 4)


@pytest.mark.parametrize("line", ["{i};p{i}.jpg;50;150", "{i};p{i}.jpg;500;500", "", "7;p.jpg;1;1"])
def test_a_file_of_wrong_lines_takes_no_longer_than_one_of_right_ones(line: str) -> None:
    """A search in a list once took 3 ms per line with swapped positions."""
    lines = "\n".join(line.format(i=i) for i in range(30_000))
    started = time.process_time()
    with pytest.raises(CfgError):
        parse_cfg(f"plan.png;200;100\n{lines}\n\n0")
    assert time.process_time() - started < 10, "30 000 lines take half a second"


def test_a_line_of_a_million_columns_makes_no_cells() -> None:
    (fault,) = (f for f in scan(b"plan.png;10;10\n" + b";" * 1_000_000).faults if f.line == 2)
    assert "1000000 characters" in fault.message and len(fault.fix) < 100
    (fault,) = (f for f in scan(b"plan.png;10;10\n0;a.jpg;1;1" + b";" * 500).faults if f.line == 2)
    assert (fault.message, fault.fix) == ("504 columns instead of 4: id;photo;x;y", "write 0;a.jpg;1;1")
