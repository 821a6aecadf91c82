"""Notes that people write on photos and on spots of a map."""

from __future__ import annotations

from dataclasses import dataclass

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.facts import TextForm
from webapp.core.texts import is_line

MOST_TITLE = 120
NOTE_TEXT = TextForm(most=4000, lines=True)
"""Of notes on photos and on spots of a map."""

MOST_NOTES = 1000
"""Largest number of notes on a map."""


@dataclass(frozen=True, slots=True)
class MapNote:
    id: int
    """Unique among the notes of the map."""
    title: str
    position: MapPixel | None
    """None if the map's image was replaced by one that does not show the spot."""
    text: str = ""
    photos: tuple[int, ...] = ()
    """Ids of the photos that it refers to."""
    floor: int = BASE_FLOOR


def title_problem(title: str) -> str | None:
    """Return what is wrong with the title of a note; None if it is valid."""
    if not is_line(title, most=MOST_TITLE):
        return f"must be one line of 1 to {MOST_TITLE} readable characters, without spaces at its ends"
    return None
