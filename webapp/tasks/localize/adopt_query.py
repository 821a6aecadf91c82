"""Adds a query photo to the map as an experience, at its localized position."""

from __future__ import annotations

import math
import os
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.orm import Session

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.atomic import storage_error
from webapp.files.localize.adopted import AdoptedPhoto
from webapp.files.part_file import discard
from webapp.settings import Settings
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo, QueryRecord
from webapp.tasks.localize import show_query
from webapp.tasks.maps import add_photo
from webapp.tasks.maps.add_photo import IncomingPhoto
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.placing import RequestedPose, find_spots, needed_image, place_spots

_SAME_PX = 1.0
"""A photo that is no farther from the answer's position was not moved by a person."""
_CONFIRMS_M = 15.0
"""GPS confirms a position that is at most so far away, if its own radius is at most that, too."""


@dataclass(frozen=True, slots=True)
class Spot:
    """Where the photo was taken, as stated by the user; None uses the first hypothesis."""

    position: MapPixel | None = None
    heading_deg: float | None = None
    floor: int | None = None


@dataclass(frozen=True, slots=True)
class Adopted:
    """The new experience."""

    id: int  # Id of the photo in the map
    position: MapPixel
    heading_deg: float | None
    job: int | None  # Id of the job that adds it to the index; only this photo is extracted


def adopt_query(
    library: Library, map_id: int, *, query_id: int, spot: Spot, account_id: int, settings: Settings
) -> Adopted:
    """Add the photo of an answer to the map, and place it by an edit that can be undone.

    If the process is killed in between, the photo remains in the tray; a repeated call places it.

    Raises:
        NotFound: The answer does not exist, or its photo is missing.
        Conflict: The photo is placed on the map already.
        UsageError: The answer has no hypothesis and no position is given, or the position is outside the
            image.
        PhotoError, StorageError
    """
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("the map was deleted")
        query = queries.find(session, record, query_id)
        at = _where(query, spot)
        position, heading = at.position, at.heading_deg
        assert position is not None
        _check_inside(record, position)
    part = library.uploads / f"{secrets.token_hex(16)}.part"
    try:
        link_or_copy(show_query.original(library, query), part)
        intake = add_photo.add_photo(
            library, map_id, photo=IncomingPhoto(part, query.name), settings=settings, by_gps=False
        )
    finally:
        discard(part)
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        photo = maps.photo(session, record, intake.id)
        if intake.duplicate and photo.x_px is not None:
            raise Conflict(
                "this photo is on the map already", where=f"photo/{photo.id}", hint="move it in the editor"
            )
        _place(session, record, photo=photo, at=at, account_id=account_id)
        queries.find(session, record, query_id).adopted_id = photo.id
    return Adopted(photo.id, position, heading, change.job)


def independent_photos(session: Session, record: MapRecord) -> list[AdoptedPhoto]:
    """List the photos on a map that were queries before, and whose positions say how right the answers were.

    A position that was accepted as it was computed does not: if it is wrong, so is what would be learned.
    """
    found = georeference(record)
    return [
        AdoptedPhoto(photo.id, newer)
        for photo, query, newer in queries.adopted(session, record)
        if _is_corrected(photo, query) or _is_confirmed(photo, found)
    ]


def _is_corrected(photo: Photo, query: QueryRecord) -> bool:
    first = next(iter(query.answer["hypotheses"]), None)
    if first is None or photo.floor != first.get("floor", photo.floor):
        return True
    assert photo.x_px is not None and photo.y_px is not None
    return math.dist((photo.x_px, photo.y_px), (first["x_px"], first["y_px"])) > _SAME_PX


def _is_confirmed(photo: Photo, found: Georeference | None) -> bool:
    """Return whether a photo's own GPS is near its position."""
    if found is None or photo.gps_lat is None or photo.gps_lon is None:
        return False
    assert photo.x_px is not None and photo.y_px is not None
    at, gps = found.latlon_of(MapPixel(photo.x_px, photo.y_px)), LatLon(photo.gps_lat, photo.gps_lon)
    away = LocalFrame(gps).enu_of(at)
    return math.hypot(away.east, away.north) <= _CONFIRMS_M and (photo.gps_accuracy_m or 0.0) <= _CONFIRMS_M


def link_or_copy(source: Path, target: Path) -> None:
    """Hard-link an immutable file, or copy it if the file system does not support links.

    Raises:
        StorageError: The file cannot be written.
    """
    try:
        os.link(source, target)
    except OSError:
        try:
            shutil.copyfile(source, target)
        except OSError as error:
            raise storage_error(error, where=target.name) from error


def _where(query: QueryRecord, spot: Spot) -> Spot:
    first = next(iter(query.answer["hypotheses"]), None)
    if spot.position is not None:
        return spot
    if first is None:
        raise UsageError("the position of this photo is unknown", where="x_px", hint="give it: x_px and y_px")
    heading = first["heading_deg"] if spot.heading_deg is None else spot.heading_deg
    floor = first.get("floor") if spot.floor is None else spot.floor
    return Spot(MapPixel(first["x_px"], first["y_px"]), heading, floor)


def _check_inside(record: MapRecord, position: MapPixel) -> None:
    image = needed_image(record, with_georeference=False)
    if not (0 <= position.x <= image.width and 0 <= position.y <= image.height):
        raise UsageError(
            f"the position ({position.x:g}, {position.y:g}) is outside the image",
            where="x_px",
            hint=f"x is from 0 to {image.width}, y from 0 to {image.height} pixels",
        )


def _place(session: Session, record: MapRecord, *, photo: Photo, at: Spot, account_id: int) -> None:
    assert at.position is not None
    image = needed_image(record, with_georeference=False)
    spots = find_spots(image, [RequestedPose(photo, at.position, at.heading_deg, floor=at.floor)])
    place_spots(session, record, spots=spots, kind="place", account_id=account_id)
