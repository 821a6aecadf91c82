"""Checks of a map that can be parsed."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from webapp.core.geo.types import MapPixel, whole_pixel
from webapp.core.mapmodel.findings import Code, Finding, quoted
from webapp.core.mapmodel.paths import name_problem

MAX_NUMBER = 2**31 - 1
"""Largest id, size and coordinate: ids are 32-bit integers in answers."""

_MIN_EXPECTED = 3
"""Least number of photos with a GPS position for a check against GPS."""


@dataclass(frozen=True, slots=True)
class ImageLine:
    """The first line: satellite image, width and height in pixels.

    `columns` holds the first column of each of the three, from 1.
    """

    image: str | None
    width: int | None
    height: int | None
    columns: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class PhotoLine:
    """One experience: id, photo, pixels from the left edge and from the top edge.

    `line` counts from 1; `columns` holds the first column of each of the four, from 1.
    """

    line: int
    id: int | None
    photo: str | None
    x: int | None
    y: int | None
    columns: tuple[int, int, int, int]

    def text(self, *, x: int | None = None, y: int | None = None, id: int | None = None) -> str:
        """Write the line in canonical form; given values replace its own."""
        values = (
            self.id if id is None else id,
            self.photo,
            self.x if x is None else x,
            self.y if y is None else y,
        )
        return ";".join("?" if value is None else str(value) for value in values)


@dataclass(frozen=True, slots=True)
class FileFacts:
    """State of the file of a photo or of the satellite image in the map's folder."""

    # "outside": a link leads out of the map's folder.
    state: Literal["ok", "missing", "unreadable", "outside"]
    reason: str = ""  # Why it is unreadable, or the target of the link
    actual: str | None = None  # A name in the folder that differs only in spelling, if there is one
    gps: MapPixel | None = None  # Its GPS position, on the map


@dataclass(frozen=True, slots=True)
class FolderFacts:
    satellite: FileFacts
    satellite_size: tuple[int, int] | None = None  # Actual width and height of the satellite image, pixels
    # By the name in the `.cfg`; a name without facts is not checked.
    photos: Mapping[str, FileFacts] = field(default_factory=dict)
    orphans: Sequence[str] = ()  # Photos in the folder that the map does not name


def check_lines(image: ImageLine | None, photos: Sequence[PhotoLine]) -> list[Finding]:
    """Check the lines against each other: duplicate ids and photos, positions outside, swapped x and y.

    Args:
        image: None when the first line could not be read.

    Returns:
        The errors among them make a `.cfg` unreadable.
    """
    found = [*_duplicate_ids(photos), *_duplicate_photos(photos)]
    if image and image.width is not None and image.height is not None:
        found += _outside(image.width, image.height, photos)
    if image and not photos:
        found.append(
            Finding(Code.NO_PHOTOS, 1, 1, "the map has no photos yet", "add a line such as 0;photo.jpg;X;Y")
        )
    return found


def check_folder(
    image: ImageLine | None, photos: Sequence[PhotoLine], *, facts: FolderFacts
) -> list[Finding]:
    """Check the map against the files in its folder."""
    found = list(_satellite(image, facts)) if image else []
    for line in photos:
        if line.photo is not None and line.photo in facts.photos:
            found += _photo(line, facts.photos[line.photo])
    found += _gps_swapped(photos, facts.photos)
    after = max((line.line for line in photos), default=1) + 1
    ids = itertools.count(free_id(photos))
    for name in facts.orphans:
        fix = f"add the line {next(ids)};{name};X;Y with its position, or move the photo out of the folder"
        if name_problem(name):
            fix = "rename the photo (a map cannot hold this name), or move it out of the folder"
        message = f"the photo {quoted(name)} is in the folder but not in the map"
        found.append(Finding(Code.ORPHAN_PHOTO, after, 1, message, fix))
    return found


def free_id(photos: Sequence[PhotoLine]) -> int:
    """Return the smallest id above all ids of the lines."""
    return max((line.id for line in photos if line.id is not None), default=-1) + 1


def _duplicate_ids(photos: Sequence[PhotoLine]) -> Iterator[Finding]:
    first: dict[int, int] = {}
    ids = itertools.count(free_id(photos))
    for line in photos:
        if line.id is None:
            continue
        if line.id in first:
            fix = f"use a free id: {line.text(id=next(ids))}"
            message = f"the id {line.id} is already on line {first[line.id]}"
            yield Finding(Code.DUPLICATE_ID, line.line, line.columns[0], message, fix)
        first.setdefault(line.id, line.line)


def _duplicate_photos(photos: Sequence[PhotoLine]) -> Iterator[Finding]:
    first: dict[str, int] = {}
    for line in photos:
        if line.photo is None:
            continue
        if line.photo in first:
            message = f"the photo {quoted(line.photo)} is already on line {first[line.photo]}"
            fix = "delete one of the two lines, unless the photo is meant to be in two places"
            yield Finding(Code.DUPLICATE_PHOTO, line.line, line.columns[1], message, fix)
        first.setdefault(line.photo, line.line)


def _outside(width: int, height: int, photos: Sequence[PhotoLine]) -> list[Finding]:
    """Find positions outside the image, and detect if swapping x and y would move most of them inside."""
    outside = [line for line in photos if not _fits(line.x, width) or not _fits(line.y, height)]
    cured = [line for line in outside if _fits_swapped(line, width, height)]
    swapped = bool(cured) and 2 * len(cured) >= len(outside)
    found = []
    for line in outside:
        bad_x = not _fits(line.x, width)
        axis, value, limit = ("x", line.x, width) if bad_x else ("y", line.y, height)
        message = f"{axis} = {value} is outside the image, whose {'width' if bad_x else 'height'} is {limit}"
        fix = f"correct it to x from 0 to {width} and y from 0 to {height}, or delete the line"
        if swapped and _fits_swapped(line, width, height):
            fix = f"x and y seem to be swapped: {line.text(x=line.y, y=line.x)}"
        found.append(
            Finding(Code.POSITION_OUTSIDE_IMAGE, line.line, line.columns[2 if bad_x else 3], message, fix)
        )
    if swapped:
        everything = all(_fits_swapped(line, width, height) for line in photos)
        message = (
            f"x and y seem to be swapped: {len(cured)} of {len(outside)} positions outside would be inside"
        )
        fix = "swap the last two columns on " + (
            "every line" if everything else "the lines with positions outside"
        )
        found.append(Finding(Code.SWAPPED_XY, cured[0].line, cured[0].columns[2], message, fix))
    return found


def _fits(value: int | None, limit: int) -> bool:
    """Return whether a coordinate is on the image; true for one that could not be read."""
    return value is None or 0 <= value <= limit


def _fits_swapped(line: PhotoLine, width: int, height: int) -> bool:
    return _fits(line.y, width) and _fits(line.x, height)


def _satellite(image: ImageLine, facts: FolderFacts) -> Iterator[Finding]:
    if image.image is None:
        return
    column, state, name = image.columns[0], facts.satellite, quoted(image.image)
    if state.state == "missing":
        fix = (
            f"the folder has {quoted(state.actual)}: write that name"
            if state.actual
            else f"add {name} to the folder"
        )
        yield Finding(Code.MISSING_SATELLITE, 1, column, f"there is no satellite image {name}", fix)
    elif state.state == "unreadable":
        message = f"the satellite image {name} cannot be read: {state.reason}"
        yield Finding(Code.UNREADABLE_SATELLITE, 1, column, message, "export the image again as PNG or JPEG")
    elif state.state == "outside":
        yield _leaves(1, column, name)
    elif state.actual:
        yield _spelling(1, column, name=image.image, actual=state.actual)
    size = facts.satellite_size
    stated = (image.width, image.height)
    if size is not None and None not in stated and stated != size:
        fix = (
            f"write {image.image};{size[0]};{size[1]}, or put back the image that the positions were made on"
        )
        message = f"the image is {size[0]} x {size[1]} pixels, not {stated[0]} x {stated[1]} as stated"
        yield Finding(Code.IMAGE_SIZE_DIFFERS, 1, image.columns[1], message, fix)


def _photo(line: PhotoLine, facts: FileFacts) -> Iterator[Finding]:
    assert line.photo is not None
    at, name = (line.line, line.columns[1]), quoted(line.photo)
    if facts.state == "missing":
        fix = "add the photo to the folder, or delete the line"
        if facts.actual:
            fix = f"the folder has {quoted(facts.actual)}: write that name"
        yield Finding(Code.MISSING_PHOTO, *at, f"there is no photo {name}", fix)
    elif facts.state == "unreadable":
        message = f"the photo {name} cannot be read: {facts.reason}"
        yield Finding(
            Code.UNREADABLE_PHOTO, *at, message, "copy the photo from the camera again, or delete the line"
        )
    elif facts.state == "outside":
        yield _leaves(*at, name)
    elif facts.actual:
        yield _spelling(*at, name=line.photo, actual=facts.actual)


def _leaves(line: int, column: int, name: str) -> Finding:
    message = f"{name} is a link that points outside the map's folder"
    return Finding(Code.PATH_LEAVES_FOLDER, line, column, message, "replace the link with a copy of the file")


def _spelling(line: int, column: int, *, name: str, actual: str) -> Finding:
    message = f"{quoted(name)} is spelled {quoted(actual)} in the folder and will be missing on other systems"
    return Finding(Code.NAME_SPELLING, line, column, message, f"write {actual}")


def _gps_swapped(photos: Sequence[PhotoLine], facts: Mapping[str, FileFacts]) -> Iterator[Finding]:
    """Detect swapped columns by the photos' GPS: most positions are much nearer to it when swapped."""
    judged, cured = 0, []
    for line in photos:
        known = facts.get(line.photo) if line.photo is not None else None
        if known is None or known.gps is None or line.x is None or line.y is None:
            continue
        gx, gy = whole_pixel(known.gps)
        judged += 1
        if 4 * max(abs(line.y - gx), abs(line.x - gy)) < max(abs(line.x - gx), abs(line.y - gy)):
            cured.append(line)
    if judged >= _MIN_EXPECTED and 2 * len(cured) > judged:
        message = f"x and y seem to be swapped: {len(cured)} of {judged} photos fit their GPS better then"
        fix = f"swap the last two columns: {cured[0].text(x=cured[0].y, y=cured[0].x)}, and so on"
        yield Finding(Code.SWAPPED_XY, cured[0].line, cured[0].columns[2], message, fix)
