"""Places photos by a list of file names: a `.cfg`, or a table of positions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.mapmodel.samename import match_names
from webapp.errors import UsageError
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.part_file import told_as
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import Placing, Wanted, find_spots, needed_image, place_spots


@dataclass(frozen=True, slots=True)
class Listed:
    """What a list of positions did.

    Attributes
    ----------
    unknown : tuple of str
        Names in the list that no photo of the map has.
    ambiguous : tuple of str
        Names in the list that could mean several photos, or several names that mean one.
    missing : int
        Photos of the map without a place that the list does not name.
    """

    placing: Placing
    unknown: tuple[str, ...]
    ambiguous: tuple[str, ...]
    missing: int


def place_by_file(library: Library, map_id: int, *, source: Path, name: str, account_id: int) -> Listed:
    """Place all photos that a list names, as one edit; those that have a place are moved.

    Parameters
    ----------
    source : Path
        The list; its ending says what it is, as `read_positions` has it.
    name : str
        As its sender calls it, for errors.
    account_id : int
        Who does it, and can undo it.

    Raises
    ------
    TableError, MapError
        The list breaks its format.
    UsageError
        The map has no satellite image, or no georeference where the list needs one, or the list was made on
        an image of another size.
    """
    with told_as(name, source):
        positions = read_positions(source)
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        image = needed_image(record, with_georeference=bool(positions.by_name) and not positions.in_pixels)
        _check_same_image(positions, image)
        photos = {photo.id: photo for photo in maps.photos(session, record) if not photo.removed}
        called = [(id, (photo.name, photo.path)) for id, photo in photos.items()]
        matched = match_names(positions.by_name, called)
        wanted = [
            Wanted(photos[id], positions.by_name[entry], positions.headings_deg.get(entry))
            for entry, id in matched.photo.items()
        ]
        spots = find_spots(image, wanted)
        placing = place_spots(session, record, spots=spots, kind="place-file", account_id=account_id)
        named = set(matched.photo.values())
        missing = sum(photo.x_px is None and id not in named for id, photo in photos.items())
    return Listed(replace(placing, job=change.job), matched.unknown, matched.ambiguous, missing)


def _check_same_image(positions: Positions, image: MapImage) -> None:
    size = positions.image_size
    if size is not None and size != (image.width, image.height):
        raise UsageError(
            f"the positions are on an image of {size[0]} x {size[1]} pixels, the satellite image has "
            f"{image.width} x {image.height}",
            hint="use the image that they were made on",
        )
