"""Places photos by a list that names them: what would move is shown before anything does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from sqlalchemy.orm import Session

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.samename import match_names
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
"""A photo that is moved by less stays where it is."""


@dataclass(frozen=True, slots=True)
class PositionList:
    """A list of positions, and how it is read.

    Attributes
    ----------
    file : Path
        A `.cfg` by its ending; all else is recognised by its content.
    name : str
        As its sender calls it, for errors.
    columns : str or None
        Which column of a table holds what; None to guess from its header.
    move_placed : bool
        Whether photos that have a place are moved too.
    """

    file: Path
    name: str
    columns: str | None = None
    move_placed: bool = True


@dataclass(frozen=True, slots=True)
class ListedPhoto:
    """Where a list has a photo.

    Attributes
    ----------
    before : MapPixel or None
        Where it is now.
    moved_px, moved_m : float or None
        From there; None for a photo without a place, and without a georeference.
    """

    spot: PhotoSpot
    before: MapPixel | None
    moved_px: float | None
    moved_m: float | None

    @property
    def moves(self) -> bool:
        """Whether it has a place, and another one in the list."""
        return self.spot.problem is None and self.moved_px is not None and self.moved_px >= _SAME_PX


@dataclass(frozen=True, slots=True)
class ListPreview:
    """What a list says about the photos of a map.

    Attributes
    ----------
    unknown : tuple of str
        Names in the list that no photo of the map has.
    ambiguous : tuple of str
        Names in the list that could mean several photos, several names that mean one, and names that several
        points of the list have.
    missing : int
        Photos of the map without a place that the list does not name.
    """

    photos: tuple[ListedPhoto, ...]
    unknown: tuple[str, ...]
    ambiguous: tuple[str, ...]
    missing: int


def preview(library: Library, map_id: int, *, listed: PositionList) -> ListPreview:
    """Look where the photos would come; nothing is changed.

    Raises
    ------
    TableError, TrackError, MapError
        The list breaks its format.
    UsageError
        The map has no satellite image, or no georeference where the list needs one, or the list was made on
        an image of another size; or the columns do not fit.
    """
    positions = _read(listed)
    with library.database.read() as session:
        return _match(session, session.get_one(MapRecord, map_id), positions)


def place_by_list(
    library: Library, map_id: int, *, listed: PositionList, account_id: int
) -> tuple[PlacingResult, ListPreview]:
    """Place the photos that a list names, as one edit; those that have a place are moved if that is wanted.

    Parameters
    ----------
    account_id : int
        Who does it, and can undo it.

    Returns
    -------
    ListPreview
        As `preview` would have given it.

    Raises
    ------
    TableError, TrackError, MapError, UsageError
        As `preview`.
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
        RequestedPose(photos[id], positions.by_name[entry], positions.headings_deg.get(entry))
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
