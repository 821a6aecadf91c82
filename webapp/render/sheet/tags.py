"""Sheets of printed tags at an exact size, as PDF."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from webapp.core.mapmodel.control_points import LEAST_TAG_MM, MOST_TAG_MM, TAG_FAMILIES
from webapp.core.tags.detect import modules
from webapp.errors import UsageError
from webapp.render.canvas import Point
from webapp.render.colours import INK
from webapp.render.sheet.drawing import PdfDrawing, TextStyle
from webapp.render.sheet.options import MM, PAPER_SIZES, Paper

MOST_TAGS = 200
_MARGIN_MM, _RULER_MM, _FOOT_MM = 10.0, 100.0, 12.0
_LABEL_MM = 7.0
_BLACK = (0, 0, 0)
_NUMBER = re.compile("[0-9]{1,5}")


class TagSheet(NamedTuple):
    """What is printed."""

    family: str
    numbers: Sequence[int]
    size_mm: float  # Side of the black square
    paper: Paper = "a4"


def numbers_of(text: str, *, family: str) -> list[int]:
    """Parse a list of ids such as `0-11,20`.

    Raises:
        UsageError: The text is not a list of ids, or one of them is not in the family.
    """
    last = TAG_FAMILIES[family] - 1
    found: dict[int, None] = {}
    for part in text.split(","):
        ends = [end.strip() for end in part.split("-")]
        if not 1 <= len(ends) <= 2 or not all(
            end.isascii() and end.isdigit() and len(end) < 6 for end in ends
        ):
            raise UsageError(f"{part[:40]!r} is not an id", where="ids", hint="write for example 0-11,20")
        first, most = int(ends[0]), int(ends[-1])
        if first > most or most > last:
            raise UsageError(
                f"{part.strip()} is not among the ids of {family}", where="ids", hint=f"0 to {last}"
            )
        found |= dict.fromkeys(range(first, most + 1))
    if len(found) > MOST_TAGS:
        raise UsageError(f"{len(found)} tags", where="ids", hint=f"print at most {MOST_TAGS} at once")
    return [*found]


def print_tags(sheet: TagSheet) -> bytes:
    """Print tags, as many on a page as fit, each with its id and size and a white margin; and a ruler.

    Raises:
        UsageError: A tag does not fit on the paper, or is too small or large.
    """
    size = sheet.size_mm
    if not LEAST_TAG_MM <= size <= MOST_TAG_MM:
        hint = f"{LEAST_TAG_MM:g} to {MOST_TAG_MM:g} mm"
        raise UsageError(f"a tag of {size:g} mm cannot be printed", where="size", hint=hint)
    width, height = (side / MM for side in PAPER_SIZES[sheet.paper])
    # a white margin of a module, without which a tag is not found
    margin = size / (len(modules(sheet.family, 0)))
    cell_width, cell_height = size + 2.0 * margin, size + 2.0 * margin + _LABEL_MM
    columns = int((width - 2.0 * _MARGIN_MM) // cell_width)
    rows = int((height - 2.0 * _MARGIN_MM - _FOOT_MM) // cell_height)
    if columns < 1 or rows < 1:
        most = min(width - 2.0 * _MARGIN_MM, height - 2.0 * _MARGIN_MM - _FOOT_MM - _LABEL_MM)
        largest = math.floor(most * size / (size + 2.0 * margin))
        hint = f"at most {largest} mm, or a larger paper"
        raise UsageError(f"a tag of {size:g} mm does not fit on the paper", where="size", hint=hint)
    pages = [sheet.numbers[n : n + columns * rows] for n in range(0, len(sheet.numbers), columns * rows)]
    drawing = PdfDrawing(PAPER_SIZES[sheet.paper], title=f"Tags {sheet.family}, {size:g} mm")
    gap = (width - 2.0 * _MARGIN_MM - columns * cell_width) / 2.0
    for page, numbers in enumerate(pages):
        drawing.page(PAPER_SIZES[sheet.paper], first=page == 0)
        for place, number in enumerate(numbers):
            row, column = divmod(place, columns)
            left = _MARGIN_MM + gap + column * cell_width + margin
            top = _MARGIN_MM + row * cell_height + margin
            _draw_tag(drawing, sheet, number, at=(left, top))
        _draw_ruler(drawing, (_MARGIN_MM, height - _MARGIN_MM))
    return drawing.finish()


def _draw_tag(drawing: PdfDrawing, sheet: TagSheet, number: int, *, at: Point) -> None:
    """Draw the black parts of a tag in rows, with its name below; `at` is its top left corner, mm."""
    left, top = at
    pattern = modules(sheet.family, number)
    side = sheet.size_mm / len(pattern)
    for y, line in enumerate(pattern):
        x = 0
        while x < len(line):
            end = x
            while end < len(line) and line[end]:
                end += 1
            if end > x:
                _fill(drawing, (left + x * side, top + y * side), ((end - x) * side, side))
            x = max(end, x + 1)
    name = f"{sheet.family}  {number}  ·  {sheet.size_mm:g} mm"
    below = top + sheet.size_mm + side + 4.0
    style = TextStyle(9.0, anchor="middle")
    drawing.text(((left + sheet.size_mm / 2.0) * MM, below * MM), name, style=style)


def _fill(drawing: PdfDrawing, at: Point, size: tuple[float, float]) -> None:
    (x, y), (width, height) = at, size
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    drawing.polygon([(a * MM, b * MM) for a, b in corners], colour=_BLACK)


def _draw_ruler(drawing: PdfDrawing, at: Point) -> None:
    """Draw a line of 100 mm, by which the scale of the print is checked."""
    x, y = at
    drawing.line((x * MM, y * MM), ((x + _RULER_MM) * MM, y * MM), colour=INK, width=0.6)
    for tick in range(0, int(_RULER_MM) + 1, 10):
        long = 3.0 if tick in (0, 50, 100) else 1.5
        there = (x + tick) * MM
        drawing.line((there, y * MM), (there, (y - long) * MM), colour=INK, width=0.6)
    drawing.text(((x + _RULER_MM + 3.0) * MM, y * MM), "100 mm", style=TextStyle(8.0))
