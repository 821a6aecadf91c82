"""Places many photos of a library map as one edit: shared functions, and placing by GPS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.errors import UsageError
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.place_photos import MapImage, how_far


@dataclass(frozen=True, slots=True)
class RequestedPose:
    """Requested pose of a photo; None leaves what it is unchanged, a radius of None means exact."""

    photo: Photo
    position: LatLon | MapPixel
    heading_deg: float | None = None
    radius_px: float | None = None
    floor: int | None = None
    note: str | None = None  # Only for a photo without one


@dataclass(frozen=True, slots=True)
class PhotoSpot:
    """Resulting position of a photo on the image."""

    photo: Photo
    pixel: MapPixel  # May be outside the image, or NaN
    problem: str | None  # How far outside it is
    heading_deg: float | None = None
    radius_px: float | None = None
    floor: int | None = None
    note: str | None = None


@dataclass(frozen=True, slots=True)
class OutsidePhoto:
    """A photo that is not placed, as its position is outside the image."""

    id: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class PlacingResult:
    placed: tuple[int, ...]  # Ids of the photos, including those that have not moved
    outside: tuple[OutsidePhoto, ...]
    job: int | None = None  # Id of the job that updates the index, if the set of placed photos has changed


def image_of(record: MapRecord) -> MapImage | None:
    """Return the satellite image of a map; None if there is none yet."""
    if record.satellite_path is None or not record.satellite_width or not record.satellite_height:
        return None
    return MapImage(record.satellite_width, record.satellite_height, georeference(record))


def needed_image(record: MapRecord, *, with_georeference: bool) -> MapImage:
    """Return the satellite image of a map.

    Raises:
        UsageError: There is none, or it has no georeference and one is needed.
    """
    image = image_of(record)
    if image is None:
        raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
    if with_georeference and image.georeference is None:
        raise UsageError("the satellite image has no georeference yet", hint="give it a georeference first")
    return image


def find_spots(image: MapImage, wanted: Iterable[RequestedPose]) -> list[PhotoSpot]:
    """Compute the pixels of photos on an image; positions in degrees require its georeference."""
    spots = []
    for one in wanted:
        pixel = one.position
        if isinstance(pixel, LatLon):
            assert image.georeference is not None
            pixel = image.georeference.pixel_of(pixel)
        is_on_image = inside(pixel, width=image.width, height=image.height)
        problem = None if is_on_image else how_far(pixel, image)
        note = None if one.photo.note else one.note
        spots.append(PhotoSpot(one.photo, pixel, problem, one.heading_deg, one.radius_px, one.floor, note))
    return spots


def place_spots(
    session: Session, record: MapRecord, *, spots: Iterable[PhotoSpot], kind: str, account_id: int
) -> PlacingResult:
    """Place the photos that are within the image, as one edit."""
    changes: dict[str, Mapping[str, Any]] = {}
    placed, outside = [], []
    for spot in spots:
        if spot.problem is not None:
            outside.append(OutsidePhoto(spot.photo.id, spot.photo.name, spot.problem))
            continue
        known = {
            "heading_deg": spot.heading_deg,
            "radius_px": spot.radius_px,
            "floor": spot.floor,
            "note": spot.note,
        }
        also = {name: value for name, value in known.items() if value is not None}
        changes[f"photo/{spot.photo.id}"] = {"x_px": spot.pixel.x, "y_px": spot.pixel.y, **also}
        placed.append(spot.photo.id)
    edits.apply(session, record, changes=changes, kind=kind, account_id=account_id)
    return PlacingResult(tuple(placed), tuple(outside))


def place_by_gps(library: Library, map_id: int, *, account_id: int) -> PlacingResult:
    """Place all photos in the tray whose GPS positions are within the image, as one edit.

    Raises:
        UsageError: The map has no satellite image, or the image has no georeference.
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
