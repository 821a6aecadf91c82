"""Puts many photos of a library map in places from elsewhere, as one edit: by GPS, by a list of names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.core.mapmodel.samename import match_names
from webapp.errors import UsageError
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.part_file import show_file_as
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.place_photos import MapImage, how_far


@dataclass(frozen=True, slots=True)
class RequestedPose:
    """Where a photo shall be; a heading of None leaves its heading as it is."""

    photo: Photo
    position: LatLon | MapPixel
    heading_deg: float | None = None


@dataclass(frozen=True, slots=True)
class PhotoSpot:
    """Where a photo comes on the image.

    Attributes
    ----------
    pixel : MapPixel
        Perhaps outside, or NaN.
    problem : str or None
        How far outside it is.
    """

    photo: Photo
    pixel: MapPixel
    problem: str | None
    heading_deg: float | None = None


@dataclass(frozen=True, slots=True)
class OutsidePhoto:
    """A photo that is not placed because its position is not on the image."""

    id: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class PlacingResult:
    """What was placed.

    Attributes
    ----------
    placed : tuple of int
        Ids of the photos, also of those that were there already.
    job : int or None
        That updates the index, where other photos are on the map now.
    """

    placed: tuple[int, ...]
    outside: tuple[OutsidePhoto, ...]
    job: int | None = None


def image_of(record: MapRecord) -> MapImage | None:
    """Return the satellite image of a map; None as long as there is none."""
    if record.satellite_path is None or not record.satellite_width or not record.satellite_height:
        return None
    return MapImage(record.satellite_width, record.satellite_height, georeference(record))


def needed_image(record: MapRecord, *, with_georeference: bool) -> MapImage:
    """Return the satellite image of a map.

    Raises
    ------
    UsageError
        There is none, or it has no georeference and one is needed.
    """
    image = image_of(record)
    if image is None:
        raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
    if with_georeference and image.georeference is None:
        raise UsageError("the satellite image has no georeference yet", hint="give it a georeference first")
    return image


def find_spots(image: MapImage, wanted: Iterable[RequestedPose]) -> list[PhotoSpot]:
    """Compute where photos come on an image, which has a georeference where positions are in degrees."""
    spots = []
    for one in wanted:
        pixel = one.position
        if isinstance(pixel, LatLon):
            assert image.georeference is not None
            pixel = image.georeference.pixel_of(pixel)
        on_it = inside(pixel, width=image.width, height=image.height)
        spots.append(PhotoSpot(one.photo, pixel, None if on_it else how_far(pixel, image), one.heading_deg))
    return spots


def place_spots(
    session: Session, record: MapRecord, *, spots: Iterable[PhotoSpot], kind: str, account_id: int
) -> PlacingResult:
    """Place the photos that come on the image, as one edit.

    Parameters
    ----------
    session : Session
        That writes.
    kind : str
        Of the edit.
    account_id : int
        Who does it.
    """
    changes: dict[str, Mapping[str, Any]] = {}
    placed, outside = [], []
    for spot in spots:
        if spot.problem is not None:
            outside.append(OutsidePhoto(spot.photo.id, spot.photo.name, spot.problem))
            continue
        turned = {} if spot.heading_deg is None else {"heading_deg": spot.heading_deg}
        changes[f"photo/{spot.photo.id}"] = {"x_px": spot.pixel.x, "y_px": spot.pixel.y, **turned}
        placed.append(spot.photo.id)
    edits.apply(session, record, changes=changes, kind=kind, account_id=account_id)
    return PlacingResult(tuple(placed), tuple(outside))


def place_by_gps(library: Library, map_id: int, *, account_id: int) -> PlacingResult:
    """Place every photo that has no place yet and a GPS position on the image, as one edit.

    Parameters
    ----------
    account_id : int
        Who does it, and can undo it.

    Raises
    ------
    UsageError
        The map has no satellite image, or that no georeference.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        image = needed_image(record, with_georeference=True)
        wanted = [
            RequestedPose(photo, LatLon(photo.gps_lat, photo.gps_lon))
            for photo in maps.photos(session, record)
            if not photo.removed
            and photo.x_px is None
            and photo.gps_lat is not None
            and photo.gps_lon is not None
        ]
        spots = find_spots(image, wanted)
        placing = place_spots(session, record, spots=spots, kind="place-gps", account_id=account_id)
    return replace(placing, job=change.job)


@dataclass(frozen=True, slots=True)
class ListReport:
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

    placing: PlacingResult
    unknown: tuple[str, ...]
    ambiguous: tuple[str, ...]
    missing: int


def place_by_file(library: Library, map_id: int, *, source: Path, name: str, account_id: int) -> ListReport:
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
    with show_file_as(name, source):
        positions = read_positions(source)
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        image = needed_image(record, with_georeference=bool(positions.by_name) and not positions.in_pixels)
        _check_same_image(positions, image)
        photos = {photo.id: photo for photo in maps.photos(session, record) if not photo.removed}
        called = [(id, (photo.name, photo.path)) for id, photo in photos.items()]
        matched = match_names(positions.by_name, called)
        wanted = [
            RequestedPose(photos[id], positions.by_name[entry], positions.headings_deg.get(entry))
            for entry, id in matched.photo.items()
        ]
        spots = find_spots(image, wanted)
        placing = place_spots(session, record, spots=spots, kind="place-file", account_id=account_id)
        named = set(matched.photo.values())
        missing = sum(photo.x_px is None and id not in named for id, photo in photos.items())
    return ListReport(replace(placing, job=change.job), matched.unknown, matched.ambiguous, missing)


def _check_same_image(positions: Positions, image: MapImage) -> None:
    size = positions.image_size
    if size is not None and size != (image.width, image.height):
        raise UsageError(
            f"the positions are on an image of {size[0]} x {size[1]} pixels, the satellite image has "
            f"{image.width} x {image.height}",
            hint="use the image that they were made on",
        )
