"""Drawing on a sheet of paper: shapes, text and labels without overlaps, as PDF or as pixels."""

from __future__ import annotations

import io
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from reportlab.lib.utils import ImageReader
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.pdfgen.canvas import Canvas as PdfCanvas

from webapp.render.canvas import Canvas, Point
from webapp.render.colours import INK, RGB
from webapp.resources import resource_folder

Anchor = Literal["left", "middle", "right"]

_HALO: RGB = (255, 255, 255)
_JPEG_QUALITY = 90
_MEASURED_PT = 100
"""Font size at which widths are measured; they are proportional to it."""

_registering = threading.Lock()


class TextStyle(NamedTuple):
    """How a line of text looks."""

    size: float  # Of the font, points
    colour: RGB = INK
    bold: bool = False
    # "left", "middle" or "right". Which part of the line is at its position, on the baseline.
    anchor: Anchor = "left"
    halo: float = 0.0  # Width of a white rim, points


class Drawing(Protocol):
    """A sheet; positions and lengths are points, from the top left corner, y down."""

    def image(self, pixels: NDArray[np.uint8], box: Box) -> None:
        """Put a picture of (h, w, 3) uint8, red, green, blue, into a box."""

    def disc(self, centre: Point, radius: float, *, colour: RGB, opacity: float = 1.0) -> None:
        """Fill a circle."""

    def ring(self, centre: Point, radius: float, *, colour: RGB, width: float) -> None:
        """Draw a circle's line."""

    def polygon(self, corners: Sequence[Point], *, colour: RGB) -> None:
        """Fill a convex polygon."""

    def line(self, start: Point, end: Point, *, colour: RGB, width: float) -> None:
        """Draw a straight line."""

    def text(self, at: Point, text: str, *, style: TextStyle) -> None:
        """Write one line; in a PNG it is above everything else."""

    def finish(self) -> bytes:
        """Return the file."""


def text_width(text: str, size: float, *, bold: bool = False) -> float:
    """Return the width of a line, points."""
    return float(_font(_MEASURED_PT, bold).getlength(text)) * size / _MEASURED_PT


def shorten(text: str, size: float, *, width: float, bold: bool = False) -> str:
    """Truncate the end of a text until it is at most `width` points wide."""
    if text_width(text, size, bold=bold) <= width:
        return text
    least, most = 0, len(text)
    while least < most:
        middle = (least + most + 1) // 2
        fits = text_width(f"{text[:middle].rstrip()}…", size, bold=bold) <= width
        least, most = (middle, most) if fits else (least, middle - 1)
    return f"{text[:least].rstrip()}…"


class PngDrawing:
    """A sheet of pixels.

    Args:
        size: Width and height, points.
        dpi: Pixels per inch.
    """

    def __init__(self, size: tuple[float, float], *, dpi: int) -> None:
        self._scale = dpi / 72
        self._dpi = dpi
        width, height = (round(side * self._scale) for side in size)
        self._canvas = Canvas(np.full((height, width, 3), 255, np.uint8))
        self._texts: list[tuple[Point, str, TextStyle]] = []

    def image(self, pixels: NDArray[np.uint8], box: Box) -> None:
        left, top, right, bottom = (round(side * self._scale) for side in box)
        shrinks = right - left < pixels.shape[1]
        way = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        scaled = cv2.resize(pixels, (max(1, right - left), max(1, bottom - top)), interpolation=way)
        self._canvas.paste(np.asarray(scaled, np.uint8), at=(left, top))

    def disc(self, centre: Point, radius: float, *, colour: RGB, opacity: float = 1.0) -> None:
        at, reach = self._px(centre), radius * self._scale
        if opacity >= 1:
            self._canvas.disc(at, reach, colour=colour)
            return
        x0, y0 = (max(0, int(v - reach) - 2) for v in at)
        part = self._canvas.pixels[y0 : max(y0, int(at[1] + reach) + 3), x0 : max(x0, int(at[0] + reach) + 3)]
        if part.size:
            over = Canvas(part.copy())
            over.disc((at[0] - x0, at[1] - y0), reach, colour=colour)
            part[...] = cv2.addWeighted(over.pixels, opacity, part, 1 - opacity, 0)

    def ring(self, centre: Point, radius: float, *, colour: RGB, width: float) -> None:
        """Draw a circle's line."""
        self._canvas.ring(self._px(centre), radius * self._scale, colour=colour, width=width * self._scale)

    def polygon(self, corners: Sequence[Point], *, colour: RGB) -> None:
        self._canvas.polygon([self._px(corner) for corner in corners], colour=colour)

    def line(self, start: Point, end: Point, *, colour: RGB, width: float) -> None:
        thick = max(1, round(width * self._scale))
        self._canvas.line(self._px(start), self._px(end), colour=colour, width=thick)

    def text(self, at: Point, text: str, *, style: TextStyle) -> None:
        """Write one line, above everything else."""
        self._texts.append((at, text, style))

    def finish(self) -> bytes:
        image = self._canvas.image()
        pen = ImageDraw.Draw(image)
        for (x, y), text, style in self._texts:
            pen.text(
                (x * self._scale, y * self._scale),
                text,
                fill=style.colour,
                font=_font(round(style.size * self._scale, 2), style.bold),
                anchor=f"{style.anchor[0]}s",
                stroke_width=style.halo * self._scale,
                stroke_fill=_HALO,
            )
        data = io.BytesIO()
        image.save(data, "PNG", dpi=(self._dpi, self._dpi))
        return data.getvalue()

    def _px(self, point: Point) -> Point:
        return point[0] * self._scale - 0.5, point[1] * self._scale - 0.5


class PdfDrawing:
    """A PDF, with vector shapes and text.

    Args:
        size: Width and height, points.
    """

    def __init__(self, size: tuple[float, float], *, title: str) -> None:
        self._fonts = pdf_fonts()
        self._height = size[1]
        self._data = io.BytesIO()
        self._canvas = PdfCanvas(self._data, pagesize=size, invariant=1)
        self._canvas.setTitle(title)
        self._canvas.setCreator("Experience Map")
        self._canvas.setLineCap(1)

    def page(self, size: tuple[float, float], *, first: bool) -> None:
        """Begin a page of this size; the first one exists already."""
        if not first:
            self._canvas.showPage()
        self._height = size[1]
        self._canvas.setPageSize(size)
        self._canvas.setLineCap(1)

    def image(self, pixels: NDArray[np.uint8], box: Box) -> None:
        """Put a picture into a box, as JPEG."""
        jpeg = io.BytesIO()
        Image.fromarray(pixels).save(jpeg, "JPEG", quality=_JPEG_QUALITY)
        jpeg.seek(0)
        size = {"width": box.right - box.left, "height": box.bottom - box.top}
        self._canvas.drawImage(ImageReader(jpeg), box.left, self._height - box.bottom, **size)

    def disc(self, centre: Point, radius: float, *, colour: RGB, opacity: float = 1.0) -> None:
        self._fill(colour, opacity)
        self._canvas.circle(centre[0], self._height - centre[1], radius, stroke=0, fill=1)

    def ring(self, centre: Point, radius: float, *, colour: RGB, width: float) -> None:
        """Draw a circle's line."""
        self._stroke(colour, width)
        self._canvas.circle(centre[0], self._height - centre[1], radius, stroke=1, fill=0)

    def polygon(self, corners: Sequence[Point], *, colour: RGB) -> None:
        self._fill(colour)
        path = self._canvas.beginPath()
        for n, (x, y) in enumerate(corners):
            (path.lineTo if n else path.moveTo)(x, self._height - y)
        path.close()
        self._canvas.drawPath(path, stroke=0, fill=1)

    def line(self, start: Point, end: Point, *, colour: RGB, width: float) -> None:
        self._stroke(colour, width)
        self._canvas.line(start[0], self._height - start[1], end[0], self._height - end[1])

    def text(self, at: Point, text: str, *, style: TextStyle) -> None:
        shift = {"left": 0.0, "middle": 0.5, "right": 1.0}[style.anchor]
        x = at[0] - shift * text_width(text, style.size, bold=style.bold)
        self._canvas.setFont(self._fonts[style.bold], style.size)
        if style.halo:
            self._stroke(_HALO, 2 * style.halo)
            self._canvas.drawString(x, self._height - at[1], text, mode=1)
        self._fill(style.colour)
        self._canvas.drawString(x, self._height - at[1], text, mode=0)

    def finish(self) -> bytes:
        self._canvas.save()
        return self._data.getvalue()

    def _fill(self, colour: RGB, opacity: float = 1.0) -> None:
        self._canvas.setFillColorRGB(*(part / 255 for part in colour))
        self._canvas.setFillAlpha(opacity)

    def _stroke(self, colour: RGB, width: float) -> None:
        self._canvas.setStrokeColorRGB(*(part / 255 for part in colour))
        self._canvas.setLineWidth(width)


def _font_file(bold: bool) -> str:
    name = "DejaVuSansCondensed-Bold.ttf" if bold else "DejaVuSansCondensed.ttf"
    return str(resource_folder("static") / "vendor" / "dejavu" / name)


@lru_cache(64)
def _font(size: float, bold: bool) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(_font_file(bold), size)


def pdf_fonts() -> tuple[str, str]:
    """Register the regular and the bold font for PDFs; return their names."""
    names = ("ExperienceMap", "ExperienceMap-Bold")
    with _registering:
        for bold, name in enumerate(names):
            if name not in pdfmetrics.getRegisteredFontNames():
                pdfmetrics.registerFont(TTFont(name, _font_file(bool(bold))))
    return names


_CELL = 16.0
"""Side of the cells of the grid in which boxes are looked up, points."""


class Box(NamedTuple):
    """A rectangle, y down."""

    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other: Box) -> bool:
        """Return whether two boxes have more than an edge in common."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )

    def within(self, other: Box) -> bool:
        return (
            other.left <= self.left
            and self.right <= other.right
            and other.top <= self.top
            and self.bottom <= other.bottom
        )


class LabelWanted(NamedTuple):
    # `x`, `y`, `reach`: Centre and radius of the mark.
    x: float
    y: float
    reach: float
    # `width`, `height`: Of the label.
    width: float
    height: float


class _Taken:
    """The boxes that are already on the sheet, in a grid."""

    def __init__(self, boxes: Iterable[Box]) -> None:
        self._cells: dict[tuple[int, int], list[Box]] = defaultdict(list)
        for box in boxes:
            self.add(box)

    def add(self, box: Box) -> None:
        for cell in _cells(box):
            self._cells[cell].append(box)

    def free(self, box: Box) -> bool:
        return not any(box.overlaps(other) for cell in _cells(box) for other in self._cells.get(cell, ()))


def place_labels(wanted: Sequence[LabelWanted], *, taken: Iterable[Box], frame: Box) -> list[Box | None]:
    """Place labels around their marks so that they overlap neither a mark nor one another.

    Args:
        wanted: In the order of priority.
        taken: Areas that must stay visible: the marks.

    Returns:
        None for labels that do not fit.
    """
    there, found = _Taken(taken), list[Box | None]()
    for label in wanted:
        box = next((b for b in _around(label) if b.within(frame) and there.free(b)), None)
        if box is not None:
            there.add(box)
        found.append(box)
    return found


def _around(label: LabelWanted) -> Iterator[Box]:
    """Yield the possible places of a label: right, left, above, below, then the corners."""
    x, y, reach, width, height = label
    near = 0.75 * reach
    beside = [(reach, -height / 2), (-reach - width, -height / 2)]
    over_and_under = [(-width / 2, -reach - height), (-width / 2, reach)]
    corners = [(dx, dy) for dx in (near, -near - width) for dy in (-near - height, near)]
    for dx, dy in (*beside, *over_and_under, *corners):
        yield Box(x + dx, y + dy, x + dx + width, y + dy + height)


def _cells(box: Box) -> Iterator[tuple[int, int]]:
    for column in range(int(box.left // _CELL), int(box.right // _CELL) + 1):
        for row in range(int(box.top // _CELL), int(box.bottom // _CELL) + 1):
            yield column, row
