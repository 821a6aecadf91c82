"""Draws the icons of detected objects for other programs: a pin of the class's colour with a sign."""

from __future__ import annotations

import io
import re
import unicodedata
from collections.abc import Callable

from PIL import Image, ImageDraw, ImageFont

from webapp.core.trajectory.outgoing import kind_colour

SIDE = 64
"""Pixels, both ways."""

_FINE = 4
"""Factor by which icons are drawn larger and then scaled down, for smooth edges."""

Pen = ImageDraw.ImageDraw
_INK = "#ffffff"


def icon(kind: str) -> bytes:
    """Draw the icon of a class of objects.

    Parameters
    ----------
    kind : str
        Any text; a class without a sign of its own shows its first letter, or a dot.

    Returns
    -------
    bytes
        PNG, `SIDE` x `SIDE`, transparent around the pin; its tip is in the middle of the lower edge.
    """
    picture = Image.new("RGBA", (SIDE * _FINE, SIDE * _FINE))
    pen = ImageDraw.Draw(picture)
    colour = kind_colour(kind)
    pen.polygon(_scaled((15, 36), (49, 36), (32, 63)), fill=_INK)
    pen.ellipse(_scaled((8, 1), (56, 49)), fill=_INK)
    pen.polygon(_scaled((18, 37), (46, 37), (32, 60)), fill=colour)
    pen.ellipse(_scaled((10, 3), (54, 47)), fill=colour)
    draw = next((sign for words, sign in _SIGNS if re.search(words, kind.lower())), None)
    if draw is None:
        _letter(pen, kind)
    else:
        draw(pen)
    file = io.BytesIO()
    picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS).save(file, "PNG", optimize=True)
    return file.getvalue()


def _scaled(*points: tuple[float, float]) -> list[tuple[float, float]]:
    return [(x * _FINE, y * _FINE) for x, y in points]


def _letter(pen: Pen, kind: str) -> None:
    """Write the first letter; a dot where there is none that the font of Pillow has."""
    plain = unicodedata.normalize("NFKD", kind.strip()[:1]).encode("ascii", "ignore").decode()
    letter = plain[:1].upper()
    if not letter.isalnum():
        pen.ellipse(_scaled((25, 18), (39, 32)), fill=_INK)
        return
    font = ImageFont.load_default(size=28 * _FINE)
    pen.text(_scaled((32, 25))[0], letter, fill=_INK, font=font, anchor="mm")


def _person(pen: Pen) -> None:
    pen.ellipse(_scaled((27, 9), (37, 19)), fill=_INK)
    pen.rounded_rectangle(_scaled((22, 21), (42, 40)), radius=9 * _FINE, fill=_INK)


def _car(pen: Pen) -> None:
    pen.polygon(_scaled((22, 24), (26, 15), (38, 15), (42, 24)), fill=_INK)
    pen.rounded_rectangle(_scaled((17, 23), (47, 33)), radius=3 * _FINE, fill=_INK)
    pen.ellipse(_scaled((20, 29), (28, 37)), fill=_INK)
    pen.ellipse(_scaled((36, 29), (44, 37)), fill=_INK)


def _house(pen: Pen) -> None:
    pen.polygon(_scaled((16, 26), (32, 10), (48, 26)), fill=_INK)
    pen.rectangle(_scaled((21, 25), (43, 39)), fill=_INK)


def _tree(pen: Pen) -> None:
    pen.polygon(_scaled((32, 8), (45, 32), (19, 32)), fill=_INK)
    pen.rectangle(_scaled((30, 31), (34, 40)), fill=_INK)


def _fire(pen: Pen) -> None:
    flame = (
        (34, 7),
        (38, 17),
        (43, 22),
        (45, 31),
        (40, 40),
        (24, 40),
        (19, 31),
        (21, 23),
        (27, 27),
        (28, 17),
    )
    pen.polygon(_scaled(*flame), fill=_INK)


def _hazard(pen: Pen) -> None:
    pen.polygon(_scaled((32, 9), (48, 38), (16, 38)), outline=_INK, width=3 * _FINE)
    pen.line(_scaled((32, 19), (32, 29)), fill=_INK, width=3 * _FINE)
    pen.ellipse(_scaled((30, 31), (34, 35)), fill=_INK)


def _box(pen: Pen) -> None:
    pen.rectangle(_scaled((19, 13), (45, 37)), outline=_INK, width=3 * _FINE)
    pen.line(_scaled((19, 22), (45, 22)), fill=_INK, width=3 * _FINE)


def _flag(pen: Pen) -> None:
    pen.rectangle(_scaled((22, 10), (25, 41)), fill=_INK)
    pen.polygon(_scaled((25, 10), (45, 17), (25, 25)), fill=_INK)


_SIGNS: tuple[tuple[str, Callable[[Pen], None]], ...] = (
    (r"person|human|people|pedestrian|victim|\bman\b|woman|child", _person),
    (r"car\b|cars\b|vehicle|truck|\bbus\b|\bvan\b", _car),
    (r"fire\b|flame|smoke|heat", _fire),
    (r"tree|plant|bush", _tree),
    (r"house|building|door|room|stairs", _house),
    (r"sign|marker|\btag\b|landmark|light", _flag),
    (r"hazard|danger|warning|\bgas\b|hole|obstacle|debris", _hazard),
    (r"box|barrel|backpack|\bbag\b|crate|extinguisher", _box),
)
