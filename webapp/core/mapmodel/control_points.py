"""Control points: spots in the world with known positions on the map, and clicked in photos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from webapp.core.geo.types import MapPixel
from webapp.core.texts import is_line

MOST_NAME = 60

_MOST_ACCURACY_M = 1000.0

_MOST_HEIGHT_M = 20_000.0
"""Above and below zero: beyond all heights on the Earth, in any height system."""


class PhotoClick(NamedTuple):
    photo: int  # Id of the photo
    # `x`, `y`: From the top left corner, as fractions of the width and height of the upright photo; 0 to 1.
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class GroundControlPoint:
    """A named spot in the world."""

    name: str
    position: MapPixel | None = None  # None while its position on the map is unknown
    clicks: tuple[PhotoClick, ...] = ()  # At most one per photo, by id
    # Standard deviation of its position along each axis; None means one pixel of the map.
    accuracy_m: float | None = None
    height_m: float | None = None  # In metres above any reference level common to all points of the map


def name_problem(name: str) -> str | None:
    """Return what is wrong with the name of a control point; None if it is valid."""
    if not is_line(name, most=MOST_NAME) or "/" in name:
        return f"must be 1 to {MOST_NAME} readable characters, without / and without spaces at its ends"
    return None


def facts_problem(point: GroundControlPoint) -> str | None:
    """Return what is wrong with the accuracy or the height of a control point; None if they are valid."""
    accuracy, height = point.accuracy_m, point.height_m
    if accuracy is not None and not 0.0 < accuracy <= _MOST_ACCURACY_M:
        return f"has an accuracy_m that is not above 0 and at most {_MOST_ACCURACY_M:g}: {accuracy:g}"
    if height is not None and not abs(height) <= _MOST_HEIGHT_M:
        return f"has a height_m that is not from -{_MOST_HEIGHT_M:g} to {_MOST_HEIGHT_M:g}: {height:g}"
    return None
