"""Puts many photos of a library map at positions from elsewhere, as one edit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.positions import inside
from webapp.errors import UsageError
from webapp.store.maps import edits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.place_photos import MapImage, how_far


@dataclass(frozen=True, slots=True)
class Wanted:
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
class Outside:
    """A photo that is not placed because its position is not on the image."""

    id: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Placing:
    """What was placed.

    Attributes
    ----------
    placed : tuple of int
        Ids of the photos, also of those that were there already.
    job : int or None
        That updates the index, where other photos are on the map now.
    """

    placed: tuple[int, ...]
    outside: tuple[Outside, ...]
    job: int | None = None


def image_of(record: MapRecord) -> MapImage | None:
    """Give the satellite image of a map; None as long as there is none."""
    if record.satellite_path is None or not record.satellite_width or not record.satellite_height:
        return None
    return MapImage(record.satellite_width, record.satellite_height, georeference(record))


def needed_image(record: MapRecord, *, with_georeference: bool) -> MapImage:
    """Give the satellite image of a map.

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


def find_spots(image: MapImage, wanted: Iterable[Wanted]) -> list[PhotoSpot]:
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
) -> Placing:
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
            outside.append(Outside(spot.photo.id, spot.photo.name, spot.problem))
            continue
        turned = {} if spot.heading_deg is None else {"heading_deg": spot.heading_deg}
        changes[f"photo/{spot.photo.id}"] = {"x_px": spot.pixel.x, "y_px": spot.pixel.y, **turned}
        placed.append(spot.photo.id)
    edits.apply(session, record, changes=changes, kind=kind, account_id=account_id)
    return Placing(tuple(placed), tuple(outside))
