"""Floors: several images of one map, one above the other.

All floors share the pixel frame of the map's own image, and its georeference. The image of a further floor is
mapped to that frame by an affine transformation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from webapp.core.geo.affine import Affine
from webapp.core.texts import is_line

BASE_FLOOR = 0
"""Id of the floor that the map's own image shows."""

MOST_FLOORS = 200
MOST_FLOOR_NAME = 60
LARGEST_LEVEL = 1000.0


@dataclass(frozen=True, slots=True)
class FloorImage:
    path: str  # Relative to the map's folder, with forward slashes
    # `width`, `height`: Pixels.
    width: int
    height: int
    map_from_image: Affine  # Transformation from its pixels to map pixels


@dataclass(frozen=True, slots=True)
class Floor:
    id: int  # Unique in the map; `BASE_FLOOR` is that of the map's own image
    name: str  # One line
    # Orders the floors, and labels the floor switch: 0 is at ground level, halves are between floors, as in
    # OpenStreetMap's `level`.
    level: float
    height_m: float | None = None  # Above any reference level common to all floors
    image: FloorImage | None = None  # None if the map's own image shows this floor


def stretched(width: int, height: int, *, over: tuple[int, int]) -> Affine:
    """Return the transformation that stretches an image over the whole map, (width, height) `over`."""
    return (over[0] / width, 0.0, 0.0, 0.0, over[1] / height, 0.0)


def floor_name_problem(name: str) -> str | None:
    """Return what is wrong with the name of a floor; None if it is valid."""
    if not is_line(name, most=MOST_FLOOR_NAME):
        return f"must be one line of 1 to {MOST_FLOOR_NAME} readable characters, without spaces at its ends"
    return None


def level_problem(level: float) -> str | None:
    """Return what is wrong with the level of a floor; None if it is valid."""
    if not abs(level) <= LARGEST_LEVEL:  # also rejects NaN
        return f"must be a number from -{LARGEST_LEVEL:g} to {LARGEST_LEVEL:g}"
    return None


def floors_problem(floors: Iterable[Floor]) -> str | None:
    """Return what is wrong with a set of floors; None if it is valid. Unless empty, it has `BASE_FLOOR`."""
    there = list(floors)
    if len({floor.level for floor in there}) < len(there):
        return "two floors have the same level"
    if there and BASE_FLOOR not in {floor.id for floor in there}:
        return f"there is no floor {BASE_FLOOR}, which the map's image shows"
    if len(there) > MOST_FLOORS:
        return f"a map has at most {MOST_FLOORS} floors"
    return None
