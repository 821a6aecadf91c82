"""Antialiased shapes and text on a picture, with positions as floats."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from webapp.render.colours import INK, RGB

_SHIFT = 4
_UNIT = 1 << _SHIFT

Point = tuple[float, float]


class Canvas:
    """A picture to draw on; (0, 0) is the centre of its top-left pixel.

    Args:
        pixels: (height, width, 3) uint8. Red, green, blue; drawn into.
    """

    def __init__(self, pixels: NDArray[np.uint8]) -> None:
        self.pixels = np.ascontiguousarray(pixels)

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.pixels.shape[:2]
        return width, height

    def paste(self, pixels: NDArray[np.uint8], *, at: tuple[int, int]) -> None:
        """Paste another picture, its top-left pixel at `at`."""
        x, y = at
        self.pixels[y : y + pixels.shape[0], x : x + pixels.shape[1]] = pixels

    def disc(self, centre: Point, radius: float, *, colour: RGB) -> None:
        reach = round(radius * _UNIT)
        cv2.circle(self.pixels, _fixed(centre), reach, colour, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def ring(self, centre: Point, radius: float, *, colour: RGB, width: float = 1) -> None:
        """Draw a circle with exact pixel coverage: OpenCV's own thick circles are uneven."""
        (x, y), reach = centre, radius + width
        x0, y0 = (max(0, int(np.floor(v - reach))) for v in (x, y))
        part = self.pixels[y0 : max(y0, int(y + reach) + 2), x0 : max(x0, int(x + reach) + 2)]
        rows, columns = np.ogrid[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]]
        off = np.abs(np.hypot(columns - x, rows - y) - radius)
        cover = np.clip(width / 2 + 0.5 - off, 0, 1)[..., None]
        part[...] = np.rint(part * (1 - cover) + np.array(colour) * cover).astype(np.uint8)

    def line(self, start: Point, end: Point, *, colour: RGB, width: int = 1) -> None:
        cv2.line(self.pixels, _fixed(start), _fixed(end), colour, width, cv2.LINE_AA, _SHIFT)

    def polygon(self, corners: Sequence[Point], *, colour: RGB) -> None:
        points = np.array([_fixed(corner) for corner in corners], np.int32)
        cv2.fillConvexPoly(self.pixels, points, colour, cv2.LINE_AA, _SHIFT)

    def box(self, top_left: tuple[int, int], size: tuple[int, int], *, colour: RGB) -> None:
        """Fill a rectangle of whole pixels."""
        (x, y), (width, height) = top_left, size
        self.pixels[y : y + height, x : x + width] = colour

    def text(self, at: Point, text: str, *, size: float, colour: RGB = INK, anchor: str = "ls") -> None:
        """Write one line; `anchor` is Pillow's: `ls` left on the baseline, `mm` the middle of both."""
        image = Image.fromarray(self.pixels)
        ImageDraw.Draw(image).text(at, plain(text), fill=colour, font=font(size), anchor=anchor)
        self.pixels = np.array(image)

    def image(self) -> Image.Image:
        return Image.fromarray(self.pixels)

    @contextmanager
    def faint(self, opacity: float) -> Iterator[None]:
        """Draw in the block with this opacity, 0 to 1."""
        before = self.pixels.copy()
        yield
        self.pixels = cv2.addWeighted(self.pixels, opacity, before, 1 - opacity, 0).astype(np.uint8)


def _fixed(point: Point) -> tuple[int, int]:
    """Convert to OpenCV's fixed-point numbers, sixteenths of a pixel, without 32-bit overflow."""
    x, y = (int(np.clip(round(v * _UNIT), -(2**28), 2**28)) for v in point)
    return x, y


@lru_cache
def font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's own scalable font, so that pictures look the same everywhere."""
    return ImageFont.load_default(size)


def text_width(text: str, size: float) -> float:
    """Return the width of a line of text, pixels."""
    return float(font(size).getlength(plain(text)))


def plain(text: str) -> str:
    """Convert text to the characters of the font: without accents, and `?` for other scripts."""
    return "".join(c if c in "·°×±…“”" else _ascii(c) for c in text)


def _ascii(character: str) -> str:
    letters = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode("ascii")
    return letters or ("" if unicodedata.combining(character) else "?")


def shortened(text: str, size: float, *, width: float) -> str:
    """Truncate the beginning of a text to at most `width` pixels: the end of a path says most."""
    if text_width(text, size) <= width:
        return text
    while text and text_width("…" + text, size) > width:
        text = text[1:]
    return "…" + text
