"""Notes that people write on photos and on spots of a map."""

from __future__ import annotations

from dataclasses import dataclass

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.texts import has_controls, is_line

MOST_TITLE, MOST_TEXT = 120, 4000
MOST_NOTES = 1000
"""Largest number of notes on a map."""


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
        None if the map's image was replaced by one that does not show the spot.
    text : str
        May have several lines.
    photos : tuple of int
        Ids of the photos that it refers to.
    floor : int
        Id of the floor that the spot is on.
    """

    id: int
    title: str
    position: MapPixel | None
    text: str = ""
    photos: tuple[int, ...] = ()
    floor: int = BASE_FLOOR


def title_problem(title: str) -> str | None:
    """Return what is wrong with the title of a note; None if it is valid."""
    if not is_line(title, most=MOST_TITLE):
        return f"must be one line of 1 to {MOST_TITLE} readable characters, without spaces at its ends"
    return None


def text_problem(text: str) -> str | None:
    """Return what is wrong with the text of a note; None if it is valid."""
    if len(text) > MOST_TEXT or has_controls(text, besides="\n\t"):
        return f"must be at most {MOST_TEXT} characters, and no control characters"
    return None
