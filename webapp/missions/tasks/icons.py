"""Draws the symbols of detected objects for other programs."""

from __future__ import annotations

import io
import unicodedata

from PIL import Image, ImageDraw, ImageFont

from webapp.missions.core.trajectory import symbols
from webapp.missions.core.trajectory.symbols import Line, kind_colour, symbol_of

SIDE = 64
"""Width and height, pixels."""

_FINE = 4
"""Factor by which icons are drawn larger and then scaled down, for smooth edges."""

_SCALE = SIDE * _FINE / symbols.SIDE
_INK = "#14181a"
_RIM = "#ffffff"


def icon(kind: str) -> bytes:
    """Draw the symbol of a class of objects.

    Args:
        kind: Any text; a class without its own symbol shows its first letter, or a dot.

    Returns:
        PNG, `SIDE` x `SIDE`, transparent around the symbol, whose centre marks the position.
    """
    picture = Image.new("RGBA", (SIDE * _FINE, SIDE * _FINE))
    pen = ImageDraw.Draw(picture)
    symbol = symbol_of(kind)
    outline = symbols.DISC if symbol is None else symbol.frame.outline
    _stroke(pen, outline, _RIM, width=3.5, closed=True)
    pen.polygon(_scaled(outline), fill=kind_colour(kind))
    _stroke(pen, outline, _INK, width=1.5, closed=True)
    if symbol is None:
        _letter(pen, kind)
    else:
        for line in symbol.glyph:
            _stroke(pen, line, _INK, width=1.8)
    file = io.BytesIO()
    picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS).save(file, "PNG", optimize=True)
    return file.getvalue()


def _scaled(line: Line) -> list[tuple[float, float]]:
    return [(x * _SCALE, y * _SCALE) for x, y in line]


def _stroke(pen: ImageDraw.ImageDraw, line: Line, ink: str, *, width: float, closed: bool = False) -> None:
    """Draw a line with round joints and ends."""
    points = _scaled((*line, line[0]) if closed else line)
    pen.line(points, fill=ink, width=round(width * _SCALE), joint="curve")
    radius = width * _SCALE / 2
    for x, y in points:
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=ink)


def _letter(pen: ImageDraw.ImageDraw, kind: str) -> None:
    """Draw the first letter, or a dot if it is not an ASCII letter or digit."""
    plain = unicodedata.normalize("NFKD", kind.strip()[:1]).encode("ascii", "ignore").decode()
    letter = plain[:1].upper()
    ((x, y),) = _scaled(((symbols.SIDE / 2, symbols.SIDE / 2),))
    if not letter.isalnum():
        radius = 3 * _SCALE
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_RIM)
        return
    font = ImageFont.load_default(size=16 * _SCALE)
    pen.text((x, y), letter, fill=_RIM, font=font, anchor="mm")
