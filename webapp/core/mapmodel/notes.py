"""Notes: what people write on photos, and on spots of a map."""

from __future__ import annotations

from dataclasses import dataclass
from unicodedata import category

from webapp.core.geo.types import MapPixel

MOST_TITLE, MOST_TEXT = 120, 4000
MOST_NOTES = 1000
"""On a map."""

_CONTROLS = ("Cc", "Cs", "Zl", "Zp")
"""Categories of Unicode: control characters, surrogates, and separators of lines and of paragraphs."""


@dataclass(frozen=True, slots=True)
class MapNote:
    """A note on a spot of a map.

    Attributes
    ----------
    id : int
        Unique among the notes of the map.
    title : str
        One line.
    position : MapPixel or None
        None where another image of the map does not show the spot.
    text : str
        May have several lines.
    photos : tuple of int
        Ids of the photos that it is about.
    """

    id: int
    title: str
    position: MapPixel | None
    text: str = ""
    photos: tuple[int, ...] = ()


def title_problem(title: str) -> str | None:
    """Say what is wrong with the title of a note."""
    if not 0 < len(title) <= MOST_TITLE or title != title.strip() or _has_controls(title):
        return f"must be one line of 1 to {MOST_TITLE} characters, without spaces at its ends"
    return None


def text_problem(text: str) -> str | None:
    """Say what is wrong with the text of a note."""
    if len(text) > MOST_TEXT or _has_controls(text.replace("\n", "").replace("\t", "")):
        return f"must be at most {MOST_TEXT} characters, and no control characters"
    return None


def _has_controls(text: str) -> bool:
    """Return whether a text has control characters; `isprintable` would refuse no-break spaces, too."""
    return any(category(c) in _CONTROLS for c in text)
