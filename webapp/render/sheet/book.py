"""Prints several sheets as the pages of one PDF."""

from __future__ import annotations

from collections.abc import Iterable

from webapp.render.sheet.drawing import PdfDrawing
from webapp.render.sheet.options import SheetOptions, SheetWords
from webapp.render.sheet.page import SheetContent, compose, page_size


def draw_book(
    contents: Iterable[SheetContent], *, title: str, options: SheetOptions, words: SheetWords
) -> bytes:
    """Draw a PDF with a page for each content; one at a time is in memory.

    Parameters
    ----------
    title : str
        Of the document; each page has that of its content.
    """
    drawing = PdfDrawing(options.page_sizes()[0], title=title)
    for number, content in enumerate(contents):
        size = page_size(content.map, options)
        drawing.page(size, first=number == 0)
        compose(drawing, content, size=size, options=options, words=words)
    return drawing.finish()
