"""Lays out the report of a mission as a PDF."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import chain
from xml.sax.saxutils import escape

from PIL import Image as PillowImage
from reportlab.lib.colors import HexColor
from reportlab.lib.enums import TA_RIGHT
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import Flowable, Image, LongTable, Paragraph, SimpleDocTemplate, Spacer

from webapp.missions.render.report import Cell, LegendEntry, ReportContent, Section
from webapp.render.sheet.drawing import pdf_fonts

_PAPER = (210 * mm, 297 * mm)
_MARGIN = 15 * mm
_FRAME_PAD = 6.0
"""Of the frame of a page, on each side."""

_WIDTH = _PAPER[0] - 2 * _MARGIN - 2 * _FRAME_PAD
_PAD = 3.0
_PICTURE, _PICTURE_HEIGHT = 62.0, 60.0
"""Largest size of the picture of an object, points."""

_SIGN = 8.0
_MOST_CHARACTERS = 600
"""Of a line in a cell: a row has to fit on a page."""

_INK, _QUIET, _LINE = HexColor("#1b242c"), HexColor("#56636e"), HexColor("#d5dce1")


def report_pdf(report: ReportContent) -> bytes:
    """Return the report as a PDF for A4, with the numbers of the pages."""
    regular, bold = pdf_fonts()
    styles = {
        "text": ParagraphStyle("text", fontName=regular, fontSize=8, leading=10.4, textColor=_INK),
        "bold": ParagraphStyle("bold", fontName=bold, fontSize=8, leading=10.4, textColor=_INK),
        "quiet": ParagraphStyle("quiet", fontName=regular, fontSize=8, leading=10.4, textColor=_QUIET),
        "title": ParagraphStyle("title", fontName=bold, fontSize=18, leading=22, textColor=_INK),
        "head": ParagraphStyle(
            "head", fontName=bold, fontSize=11.5, leading=15, spaceBefore=12, spaceAfter=3, keepWithNext=1
        ),
    }
    styles["number"] = ParagraphStyle("number", parent=styles["text"], alignment=TA_RIGHT)
    styles["swatched"] = ParagraphStyle("swatched", parent=styles["bold"], leftIndent=_SIGN + 4)
    styles["quiet right"] = ParagraphStyle("quiet right", parent=styles["quiet"], alignment=TA_RIGHT)
    data = io.BytesIO()
    document = SimpleDocTemplate(
        data,
        pagesize=_PAPER,
        leftMargin=_MARGIN,
        rightMargin=_MARGIN,
        topMargin=_MARGIN,
        bottomMargin=_MARGIN,
        title=f"{report.title}: {report.kind}",
        creator="Experience Map",
        lang=report.language,
        invariant=1,
    )

    def number_page(canvas: Canvas, _document: SimpleDocTemplate) -> None:
        canvas.setFont(regular, 8)
        canvas.setFillColor(_QUIET)
        canvas.drawRightString(_PAPER[0] - _MARGIN, 9 * mm, str(canvas.getPageNumber()))

    story = _Story(styles).of(report)
    document.build(story, onFirstPage=number_page, onLaterPages=number_page)
    return data.getvalue()


class _Story:
    """The parts of the document, from the top to the bottom."""

    def __init__(self, styles: dict[str, ParagraphStyle]) -> None:
        self._styles = styles

    def of(self, report: ReportContent) -> list[Flowable]:
        story = [self._text(report.kind, "quiet"), self._text(report.title, "title")]
        if report.note:
            story += [Spacer(0, 4), *(self._text(line, "text") for line in report.note.splitlines() if line)]
        story += [Spacer(0, 6), self._facts(report.facts), Spacer(0, 6)]
        story += [self._text(remark, "quiet") for remark in report.remarks]
        if report.map_jpeg is not None:
            picture = _picture(report.map_jpeg, width=_WIDTH, height=_PAPER[1] - 2 * _MARGIN - 12)
            story += [Spacer(0, 8), picture, Spacer(0, 4)]
            story += self._legend(report.legend)
        for section in report.sections:
            story += [self._text(section.title, "head"), self._table(section)]
            story += [self._text(remark, "quiet") for remark in section.remarks]
        return story

    def _text(self, text: str, style: str) -> Paragraph:
        shown = text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 1]}…"
        return Paragraph(escape(shown), self._styles[style])

    def _facts(self, facts: Sequence[tuple[str, str]]) -> Flowable:
        cells = [[self._text(name, "quiet"), self._text(value, "bold")] for name, value in facts]
        rows = [cells[n : n + 3] for n in range(0, len(cells), 3)]
        rows[-1] += [[] for _ in range(3 - len(rows[-1]))]
        return LongTable(rows, colWidths=[_WIDTH / 3] * 3, style=[("LEFTPADDING", (0, 0), (-1, -1), 0)])

    def _legend(self, legend: Sequence[LegendEntry]) -> list[Flowable]:
        """Return the legend in columns."""
        if not legend:
            return []
        cells = [[self._sign(entry), self._text(entry.text, "text")] for entry in legend]
        rows = [list(chain(*cells[n : n + 3])) for n in range(0, len(cells), 3)]
        rows[-1] += [""] * (6 - len(rows[-1]))
        widths = [14.0, _WIDTH / 3 - 14.0] * 3
        return [LongTable(rows, colWidths=widths, style=[*_TIGHT, ("LEFTPADDING", (0, 0), (-1, -1), 0)])]

    def _sign(self, entry: LegendEntry) -> Flowable:
        if entry.icon is not None:
            return _picture(entry.icon, width=_SIGN + 2, height=_SIGN + 2)
        return _Swatch(entry.colour or "#000000")

    def _table(self, section: Section) -> Flowable:
        head = [
            self._text(column, "quiet right" if cell.number else "quiet")
            for column, cell in zip(section.columns, section.rows[0], strict=True)
        ]
        rows = [[self._cell(cell) for cell in row] for row in section.rows]
        widths = _widths(section)
        style = [*_TIGHT, ("LINEABOVE", (0, 1), (-1, -1), 0.4, _LINE), ("LEFTPADDING", (0, 0), (0, -1), 0)]
        return LongTable([head, *rows], colWidths=widths, repeatRows=1, splitInRow=1, style=style)

    def _cell(self, cell: Cell) -> list[Flowable]:
        style = "number" if cell.number else "bold" if cell.head else "text"
        parts: list[Flowable] = []
        if cell.picture is not None:
            parts.append(_picture(cell.picture, width=_PICTURE, height=_PICTURE_HEIGHT))
        for number, line in enumerate(cell.lines):
            if number == 0 and cell.colour:
                parts.append(_Swatched(escape(line), self._styles["swatched"], colour=cell.colour))
            else:
                parts.append(self._text(line, style if number == 0 or cell.number else "text"))
        return parts


_TIGHT = [
    ("VALIGN", (0, 0), (-1, -1), "TOP"),
    ("TOPPADDING", (0, 0), (-1, -1), 2),
    ("BOTTOMPADDING", (0, 0), (-1, -1), 2),
    ("LEFTPADDING", (0, 0), (-1, -1), _PAD),
    ("RIGHTPADDING", (0, 0), (-1, -1), _PAD),
]


class _Swatch(Flowable):  # type: ignore[misc]
    """A disc in a colour."""

    def __init__(self, colour: str) -> None:
        super().__init__()
        self.width = self.height = _SIGN
        self._colour = colour

    def draw(self) -> None:
        self.canv.setFillColor(HexColor(self._colour))
        self.canv.circle(_SIGN / 2, _SIGN / 2 - 1, _SIGN / 2, stroke=0, fill=1)


class _Swatched(Paragraph):  # type: ignore[misc]
    """A paragraph behind a disc in a colour."""

    def __init__(self, text: str, style: ParagraphStyle, *, colour: str) -> None:
        super().__init__(text, style)
        self._colour = colour

    def draw(self) -> None:
        super().draw()
        self.canv.setFillColor(HexColor(self._colour))
        self.canv.circle(_SIGN / 2, self.height - _SIGN / 2 - 1.5, _SIGN / 2, stroke=0, fill=1)


def _widths(section: Section) -> list[float]:
    """Divide the width by the longest line of each column, within limits."""
    longest = []
    for number, title in enumerate(section.columns):
        cells = [row[number] for row in section.rows]
        lines = [len(line) for cell in cells for line in cell.lines]
        least = 14 if any(cell.picture for cell in cells) else 8
        longest.append(min(max([len(title), least, *lines]), 46))
    return [_WIDTH * part / sum(longest) for part in longest]


def _picture(data: bytes, *, width: float, height: float) -> Image:
    """Scale a picture to fit into a box."""
    with PillowImage.open(io.BytesIO(data)) as image:
        scale = min(width / image.width, height / image.height)
        size = image.width * scale, image.height * scale
    return Image(io.BytesIO(data), *size, hAlign="LEFT")
