"""A printed sheet of tags: at their exact size, found again, with a ruler."""

import cv2
import numpy as np
import pytest

from webapp.core.tags.detect import find_tags
from webapp.errors import UsageError
from webapp.render.sheet import tags
from webapp.render.sheet.options import MM
from webapp.render.sheet.tags import TagSheet, numbers_of, print_tags

DOTS = 8  # Per millimetre


class Recorded:
    """A drawing that keeps pages as pixels, texts and lines."""

    def __init__(self, size, *, title):
        self.pages, self.texts, self.lines = [], [], []

    def page(self, size, *, first):
        self.pages.append(np.full((round(size[1] / MM * DOTS), round(size[0] / MM * DOTS)), 255, np.uint8))

    def polygon(self, corners, *, colour):
        rows = np.array(corners) / MM * DOTS
        (left, top), (right, bottom) = rows.min(0).round().astype(int), rows.max(0).round().astype(int)
        self.pages[-1][top:bottom, left:right] = 0

    def line(self, start, end, *, colour, width):
        self.lines.append((start, end))

    def text(self, at, text, *, style):
        self.texts.append(text)

    def finish(self):
        return b""


@pytest.fixture
def drawn(monkeypatch):
    """A function that prints a sheet and returns what was drawn."""
    made = []

    def make(size, *, title):
        made.append(Recorded(size, title=title))
        return made[-1]

    monkeypatch.setattr(tags, "PdfDrawing", make)

    def run(sheet):
        print_tags(sheet)
        return made[-1]

    return run


@pytest.mark.parametrize(("family", "size"), [("36h11", 150.0), ("5x5_100", 70.0), ("6x6_250", 40.0)])
def test_tags_are_found_with_the_size_that_is_written_under_them(drawn, family, size):
    sheet = drawn(TagSheet(family, range(7), size))
    found = [tag for page in sheet.pages for tag in find_tags(cv2.GaussianBlur(page, (0, 0), 1.5), [family])]
    assert sorted(tag.number for tag in found) == [*range(7)]
    assert [tag.side_px / DOTS for tag in found] == pytest.approx([size] * 7, abs=0.1)
    for tag in found:  # upright: the first corner is top left
        assert np.sign(tag.corners - tag.corners.mean(0)).tolist() == [[-1, -1], [1, -1], [1, 1], [-1, 1]]
        assert f"{family}  {tag.number}  ·  {size:g} mm" in sheet.texts


def test_each_page_has_a_line_of_100_mm(drawn):
    sheet = drawn(TagSheet("36h11", [1, 2], 150.0))
    long = [(a, b) for a, b in sheet.lines if abs(a[0] - b[0]) > 50.0 * MM]
    assert len(sheet.pages) == len(long) == 2
    assert all(b[0] - a[0] == pytest.approx(100.0 * MM) for a, b in long)


def test_the_file_is_a_pdf_of_the_chosen_paper():
    assert b"/MediaBox [ 0 0 612 792 ]" in print_tags(TagSheet("36h11", [0], 100.0, "letter"))


@pytest.mark.parametrize(
    ("sheet", "problem"),
    [
        (TagSheet("36h11", [0], 190.0), "does not fit"),
        (TagSheet("36h11", [0], 5.0), "cannot be printed"),
        (TagSheet("36h11", [0], float("nan")), "cannot be printed"),
    ],
)
def test_a_size_that_is_not_possible_is_refused(sheet, problem):
    with pytest.raises(UsageError, match=problem):
        print_tags(sheet)


def test_the_largest_size_that_the_error_offers_fits():
    with pytest.raises(UsageError) as refused:
        print_tags(TagSheet("36h11", [0], 500.0))
    most = float(refused.value.hint.split()[2])
    assert print_tags(TagSheet("36h11", [0], most)).startswith(b"%PDF-")


def test_ids_are_numbers_and_ranges():
    assert numbers_of("0-3, 9,2", family="36h11") == [0, 1, 2, 3, 9]


@pytest.mark.parametrize("text", ["", "a", "1-", "3-1", "-1", "1-2-3", "50", "0-400", "1,,2", "٣"])
def test_other_lists_of_ids_are_refused(text):
    with pytest.raises(UsageError):
        numbers_of(text, family="4x4_50")
