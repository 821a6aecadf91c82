"""Floors: several images of one map, one above the other.

All floors share the pixels of the map's own image: a position means the same on each of them, and so does the
georeference. The image of a further floor is laid on those pixels by an affine transformation.
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
    """The image of a floor.

    Attributes
    ----------
    path : str
        Relative to the map's folder, with forward slashes.
    width, height : int
        Pixels.
    map_from_image : Affine
        From its pixels to those of the map.
    """

    path: str
    width: int
    height: int
    map_from_image: Affine


@dataclass(frozen=True, slots=True)
class Floor:
    """One floor of a map.

    Attributes
    ----------
    id : int
        Unique in the map; `BASE_FLOOR` is that of the map's own image.
    name : str
        One line.
    level : float
        Orders the floors, and stands on the switch: 0 is at the ground, halves are between floors, as in
        OpenStreetMap's `level`.
    height_m : float or None
        Of its floor, above any level that is the same for all.
    image : FloorImage or None
        None: the map's own image shows this floor.
    """

    id: int
    name: str
    level: float
    height_m: float | None = None
    image: FloorImage | None = None


def stretched(width: int, height: int, *, over: tuple[int, int]) -> Affine:
    """Lay an image on the whole map, which is `over` pixels wide and high."""
    return (over[0] / width, 0.0, 0.0, 0.0, over[1] / height, 0.0)


def floor_name_problem(name: str) -> str | None:
    """Say what is wrong with the name of a floor."""
    if not is_line(name, most=MOST_FLOOR_NAME):
        return f"must be one line of 1 to {MOST_FLOOR_NAME} readable characters, without spaces at its ends"
    return None


def level_problem(level: float) -> str | None:
    """Say what is wrong with the level of a floor."""
    if not abs(level) <= LARGEST_LEVEL:  # not a number is none either
        return f"must be a number from -{LARGEST_LEVEL:g} to {LARGEST_LEVEL:g}"
    return None


def floors_problem(floors: Iterable[Floor]) -> str | None:
    """Say what is wrong with floors together: with some, there is one that the map's image shows."""
    there = list(floors)
    if len({floor.level for floor in there}) < len(there):
        return "two floors have the same level"
    if there and BASE_FLOOR not in {floor.id for floor in there}:
        return f"there is no floor {BASE_FLOOR}, which the map's image shows"
    if len(there) > MOST_FLOORS:
        return f"a map has at most {MOST_FLOORS} floors"
    return None
