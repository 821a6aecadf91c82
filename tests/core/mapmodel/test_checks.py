"""Problems in the lines of a map, and between them and the folder."""

from collections.abc import Sequence

import pytest

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import (
    FileFacts,
    FolderFacts,
    ImageLine,
    PhotoLine,
    check_folder,
    check_lines,
)
from webapp.core.mapmodel.findings import Code, Finding

IMAGE = ImageLine("s.png", 600, 300, (1, 7, 11))
FINE = FileFacts("ok")


def line(
    number: int, x: int | None, y: int | None, *, id: int | None = None, photo: str | None = ""
) -> PhotoLine:
    name = f"{number}.jpg" if photo == "" else photo
    return PhotoLine(number, number if id is None else id, name, x, y, (1, 3, 9, 12))


def codes(findings: Sequence[Finding]) -> list[Code]:
    return [finding.code for finding in findings]


def test_good_lines() -> None:
    assert check_lines(IMAGE, [line(2, 0, 0), line(3, 600, 300)]) == []


def test_duplicate_ids_get_free_ones() -> None:
    found = check_lines(IMAGE, [line(2, 1, 1, id=5), line(3, 1, 1, id=5), line(4, 1, 1, id=5)])
    assert codes(found) == [Code.DUPLICATE_ID, Code.DUPLICATE_ID]
    assert [(f.line, f.fix) for f in found] == [
        (3, "use a free id: 6;3.jpg;1;1"),
        (4, "use a free id: 7;4.jpg;1;1"),
    ]
    assert "already on line 2" in found[1].message


def test_photo_twice_is_a_warning() -> None:
    (found,) = check_lines(IMAGE, [line(2, 1, 1, photo="a.jpg"), line(3, 1, 1, photo="a.jpg")])
    assert (found.code, found.severity, found.line) == (Code.DUPLICATE_PHOTO, "warning", 3)


def test_outside_without_a_cure() -> None:
    found = check_lines(IMAGE, [line(2, 601, 301), line(3, -1, 5), line(4, 5, 5)])
    assert codes(found) == [Code.POSITION_OUTSIDE_IMAGE] * 2
    assert "x from 0 to 600 and y from 0 to 300" in found[0].fix


def test_swapped_when_that_cures_most() -> None:
    found = check_lines(IMAGE, [line(2, 100, 500), line(3, 20, 400), line(4, 900, 900), line(5, 50, 60)])
    assert codes(found).count(Code.POSITION_OUTSIDE_IMAGE) == 3
    swapped = [f for f in found if f.code == Code.SWAPPED_XY]
    assert [(f.line, f.severity) for f in swapped] == [(2, "warning")]
    assert "2 of 3" in swapped[0].message
    assert found[0].fix == "x and y seem to be swapped: 2;2.jpg;500;100"


def test_swapped_not_suspected_for_a_few() -> None:
    found = check_lines(IMAGE, [line(2, 100, 500), line(3, 900, 900), line(4, 800, 800)])
    assert Code.SWAPPED_XY not in codes(found)


def test_lines_with_gaps_are_not_judged() -> None:
    assert check_lines(IMAGE, [line(2, None, 5, photo=None), line(3, 5, None, photo=None)]) == []
    assert check_lines(None, [line(2, 9999, 9999)]) == []
    assert check_lines(ImageLine(None, None, 5, (1, 1, 1)), [line(2, 9999, 9999)]) == []


def test_no_photos_is_a_warning() -> None:
    assert codes(check_lines(IMAGE, [])) == [Code.NO_PHOTOS]


@pytest.mark.parametrize(
    ("facts", "code", "words"),
    [
        (FileFacts("missing"), Code.MISSING_PHOTO, "add the photo to the folder"),
        (FileFacts("missing", actual="2.JPG"), Code.MISSING_PHOTO, "the folder has '2.JPG'"),
        (FileFacts("unreadable", "cut off"), Code.UNREADABLE_PHOTO, "again"),
        (FileFacts("outside"), Code.PATH_LEAVES_FOLDER, "copy of the file"),
        (FileFacts("ok", actual="2.JPG"), Code.NAME_SPELLING, "write 2.JPG"),
    ],
)
def test_photos(facts: FileFacts, code: Code, words: str) -> None:
    (found,) = check_folder(IMAGE, [line(2, 1, 1)], facts=FolderFacts(FINE, (600, 300), {"2.jpg": facts}))
    assert (found.code, found.line, found.column) == (code, 2, 3)
    assert words in found.fix


@pytest.mark.parametrize(
    ("facts", "size", "code"),
    [
        (FileFacts("missing"), None, Code.MISSING_SATELLITE),
        (FileFacts("unreadable", "no image"), None, Code.UNREADABLE_SATELLITE),
        (FileFacts("outside"), None, Code.PATH_LEAVES_FOLDER),
        (FileFacts("ok", actual="S.png"), (600, 300), Code.NAME_SPELLING),
        (FINE, (601, 300), Code.IMAGE_SIZE_DIFFERS),
    ],
)
def test_satellite(facts: FileFacts, size: tuple[int, int] | None, code: Code) -> None:
    (found,) = check_folder(IMAGE, [], facts=FolderFacts(facts, size))
    assert (found.code, found.line) == (code, 1)
    if size == (601, 300):
        assert "s.png;601;300" in found.fix


def test_orphans_get_a_line_to_add() -> None:
    found = check_folder(
        IMAGE, [line(2, 1, 1)], facts=FolderFacts(FINE, None, {}, ["x.jpg", "y;.jpg", "z.jpg"])
    )
    assert codes(found) == [Code.ORPHAN_PHOTO] * 3
    assert [f.line for f in found] == [3, 3, 3]
    assert "3;x.jpg;X;Y" in found[0].fix and "rename" in found[1].fix and "x.jpg" in found[0].message


def gps(*positions: tuple[float, float]) -> FolderFacts:
    photos = {f"{i}.jpg": FileFacts("ok", gps=MapPixel(*p)) for i, p in enumerate(positions, start=2)}
    return FolderFacts(FINE, None, photos)


def test_swapped_against_gps() -> None:
    lines = [line(2, 10, 100), line(3, 20, 200), line(4, 30, 250), line(5, 80, 80)]
    (found,) = check_folder(IMAGE, lines, facts=gps((101, 12), (195, 20), (250, 33), (80, 81)))
    assert (found.code, found.line) == (Code.SWAPPED_XY, 2)
    assert "3 of 4" in found.message and "2;2.jpg;100;10" in found.fix


def test_imprecise_gps_is_no_suspicion() -> None:
    lines = [line(2, 10, 100), line(3, 20, 200), line(4, 30, 250)]
    assert check_folder(IMAGE, lines, facts=gps((60, 90), (25, 260), (10, 230))) == []
    assert check_folder(IMAGE, lines[:2], facts=gps((100, 10), (200, 20))) == []
