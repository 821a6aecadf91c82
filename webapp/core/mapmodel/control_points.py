"""Control points: spots in the world with known positions on the map, and clicked in photos."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from webapp.core.geo.types import MapPixel
from webapp.core.texts import is_line

MOST_NAME = 60

_MOST_ACCURACY_M = 1000.0

_MOST_HEIGHT_M = 20_000.0
"""Above and below zero: beyond all heights on the Earth, in any height system."""


TAG_FAMILIES: Mapping[str, int] = {"36h11": 587, "4x4_50": 50, "5x5_100": 100, "6x6_250": 250}
"""Families of printed tags (AprilTag 36h11, then ArUco), and how many ids each has, from 0."""

TagMount = Literal["wall", "floor"]
TAG_MOUNTS: tuple[TagMount, ...] = get_args(TagMount)

LEAST_TAG_MM, MOST_TAG_MM = 10.0, 5000.0


@dataclass(frozen=True, slots=True)
class Tag:
    """A printed tag at a control point, whose position is that of the tag's middle."""

    family: str  # One of `TAG_FAMILIES`
    number: int  # Its id in the family
    size_mm: float  # Side of its black square
    # "wall": upright on something vertical; "floor": on something level, visible from above.
    mount: TagMount = "wall"
    # Where a tag on a wall faces, and where the top of one on the floor points, degrees clockwise from north;
    # None if unknown.
    heading_deg: float | None = None

    @property
    def title(self) -> str:
        """Family and id, as they are printed under it."""
        return f"{self.family} {self.number}"


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
    tag: Tag | None = None  # The tag that is mounted there
    is_check: bool = False  # A check point: left out of every fit, to measure how accurate it is


def tag_anchors(points: Iterable[GroundControlPoint]) -> list[GroundControlPoint]:
    """Return the points on the map whose tags localize photos: those of check points do not."""
    return [
        point
        for point in points
        if point.tag is not None and point.position is not None and not point.is_check
    ]


def name_problem(name: str) -> str | None:
    """Return what is wrong with the name of a control point; None if it is valid."""
    if not is_line(name, most=MOST_NAME) or "/" in name:
        return f"must be 1 to {MOST_NAME} readable characters, without / and without spaces at its ends"
    return None


def facts_problem(point: GroundControlPoint) -> str | None:
    """Return what is wrong with accuracy, height or tag of a control point; None if they are valid."""
    accuracy, height = point.accuracy_m, point.height_m
    if accuracy is not None and not 0.0 < accuracy <= _MOST_ACCURACY_M:
        return f"has an accuracy_m that is not above 0 and at most {_MOST_ACCURACY_M:g}: {accuracy:g}"
    if height is not None and not abs(height) <= _MOST_HEIGHT_M:
        return f"has a height_m that is not from -{_MOST_HEIGHT_M:g} to {_MOST_HEIGHT_M:g}: {height:g}"
    return None if point.tag is None else _tag_problem(point.tag)


def _tag_problem(tag: Tag) -> str | None:
    if tag.family not in TAG_FAMILIES:
        return f"has a tag of an unknown family, {tag.family[:40]!r}; there are {', '.join(TAG_FAMILIES)}"
    last = TAG_FAMILIES[tag.family] - 1
    if not 0 <= tag.number <= last:
        return f"has a tag {tag.title}, but ids of {tag.family} are from 0 to {last}"
    if not LEAST_TAG_MM <= tag.size_mm <= MOST_TAG_MM:
        return f"has a tag whose size_mm is not from {LEAST_TAG_MM:g} to {MOST_TAG_MM:g}: {tag.size_mm:g}"
    if tag.mount not in TAG_MOUNTS:
        return f"has a tag that is neither on a wall nor on the floor: {tag.mount[:40]!r}"
    if tag.heading_deg is not None and not 0.0 <= tag.heading_deg < 360.0:
        return f"has a tag whose heading_deg is not from 0 to below 360: {tag.heading_deg:g}"
    return None
