"""Places photos by a list of names and positions, with a preview of the changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from sqlalchemy.orm import Session

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.name_matching import match_names
from webapp.errors import UsageError
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.part_file import show_file_as
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import (
    PhotoSpot,
    PlacingResult,
    RequestedPose,
    find_spots,
    needed_image,
    place_spots,
)

_SAME_PX = 1e-3
"""A smaller displacement does not count as a move."""


@dataclass(frozen=True, slots=True)
class PositionList:
    file: Path  # A `.cfg` is recognised by its suffix, other formats by their content
    name: str  # Original name, for error messages
    columns: str | None = None  # Meaning of the columns of a table; None to guess it from the header
    move_placed: bool = True  # Whether to move photos that have a position already


@dataclass(frozen=True, slots=True)
class ListedPhoto:
    spot: PhotoSpot
    before: MapPixel | None  # Current position
    # `moved_px`, `moved_m`: Distance from it; None without a current position, `moved_m` also without a
    # georeference.
    moved_px: float | None
    moved_m: float | None

    @property
    def moves(self) -> bool:
        """Whether it has a position, and a different one in the list."""
        return self.spot.problem is None and self.moved_px is not None and self.moved_px >= _SAME_PX


@dataclass(frozen=True, slots=True)
class ListPreview:
    photos: tuple[ListedPhoto, ...]
    unknown: tuple[str, ...]  # Names in the list that match no photo of the map
    # Names in the list that match several photos, that match the same photo as another name, or that occur
    # several times.
    ambiguous: tuple[str, ...]
    missing: int  # Number of photos of the map without a position that are not in the list


def preview_list(library: Library, map_id: int, *, listed: PositionList) -> ListPreview:
    """Preview where the photos would be placed; nothing is changed.

    Raises:
        TableError, TrackError, MapError: The list is not valid in its format.
        UsageError: The map has no satellite image, or no georeference although the list needs one; the list
            was made on an image of another size; or the columns do not fit.
    """
    positions = _read(listed)
    with library.database.read() as session:
        return _match(session, session.get_one(MapRecord, map_id), positions)


def place_by_list(
    library: Library, map_id: int, *, listed: PositionList, account_id: int
) -> tuple[PlacingResult, ListPreview]:
    """Place the photos of a list, as one edit; placed photos are moved only with `listed.move_placed`.

    Returns:
        As from `preview` just before.
    """
    positions = _read(listed)
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        seen = _match(session, record, positions)
        spots = [one.spot for one in seen.photos if one.before is None or listed.move_placed]
        placing = place_spots(session, record, spots=spots, kind="place-file", account_id=account_id)
    return replace(placing, job=change.job), seen


def _read(listed: PositionList) -> Positions:
    with show_file_as(listed.name, listed.file):
        return read_positions(listed.file, columns=listed.columns)


def _match(session: Session, record: MapRecord, positions: Positions) -> ListPreview:
    image = needed_image(record, with_georeference=bool(positions.by_name) and not positions.in_pixels)
    _check_same_image(positions, image)
    photos = {photo.id: photo for photo in maps.photos(session, record) if not photo.removed}
    called = [(id, (p.name, p.path, PurePosixPath(p.name).stem)) for id, p in photos.items()]
    matched = match_names(positions.by_name, called)
    wanted = [
        RequestedPose(
            photos[id],
            positions.by_name[entry],
            positions.headings_deg.get(entry),
            note=positions.notes.get(entry),
        )
        for entry, id in matched.photo.items()
    ]
    found = tuple(_listed(spot, image) for spot in find_spots(image, wanted))
    named = set(matched.photo.values())
    missing = sum(photo.x_px is None and id not in named for id, photo in photos.items())
    return ListPreview(found, matched.unknown, (*matched.ambiguous, *positions.repeated), missing)


def _listed(spot: PhotoSpot, image: MapImage) -> ListedPhoto:
    x, y = spot.photo.x_px, spot.photo.y_px
    if x is None or y is None:
        return ListedPhoto(spot, None, None, None)
    before = MapPixel(x, y)
    moved_px = math.dist(before, spot.pixel)
    moved_m = None
    if image.georeference is not None and spot.problem is None:
        moved_m = moved_px * image.georeference.metres_per_pixel(spot.pixel)
    return ListedPhoto(spot, before, moved_px, moved_m)


def _check_same_image(positions: Positions, image: MapImage) -> None:
    size = positions.image_size
    if size is not None and size != (image.width, image.height):
        raise UsageError(
            f"the positions are on an image of {size[0]} x {size[1]} pixels, the satellite image has "
            f"{image.width} x {image.height}",
            hint="use the image that they were made on",
        )
