"""Which changes of an album are taken over into the map, and which positions of the map go back."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.connect.libraries.protocol import Asset
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.store.maps import edits, maps
from webapp.store.maps.changing import MapChange
from webapp.store.photo_libraries import HERE, KEPT, TAKEN, LinkedAlbum, LinkedPhoto
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference, placed_by_gps
from webapp.tasks.maps.placing import image_of

REMARK = "a preview: the original is in the photo library"
"""What the map says of the file of a photo that came from an album."""

_SAME_DEG = 2e-6
"""Positions that are nearer than this are the same: photo libraries round them, this is 0.2 m."""

Changes = dict[str, dict[str, Any]]


class Followed(NamedTuple):
    removed: int
    moved: int


def follow(
    change: MapChange,
    rows: Mapping[str, LinkedPhoto],
    *,
    assets: Mapping[str, Asset],
    account_id: int | None,
) -> Followed:
    """Take over what has changed in the album since the last update, as edits that can be undone.

    Args:
        rows: Loaded in the session of the change.
    """
    session, record = change.session, change.record
    photos = _photos(session, record, rows)
    by_gps = placed_by_gps(photos.values(), georeference(record))
    shared = _elsewhere(session, rows)
    gone: Changes = {}
    moved: Changes = {}
    for id, row in rows.items():
        photo = None if row.photo_id is None else photos.get(row.photo_id)
        asset = assets.get(id)
        _settle(row, asset)
        if asset is None or row.checksum != asset.checksum:
            gone |= _leave(row, photo, asset=asset, by_gps=by_gps, shared=shared)
            continue
        if row.state != HERE:
            gone |= _return(row, photo)
        moved |= _move(record, row, photo=photo, asset=asset, by_gps=by_gps)
    edits.apply(session, record, changes=gone, kind="remove", account_id=account_id)
    edits.apply(session, record, changes=moved, kind="place-gps", account_id=account_id)
    return Followed(sum(fields["removed"] for fields in gone.values()), len(moved))


def needs_writing(
    session: Session, record: MapRecord, *, rows: Mapping[str, LinkedPhoto], assets: Mapping[str, Asset]
) -> dict[str, LatLon]:
    """Return the positions that people have set here, by asset, where the photo has none there but ours.

    One that was written and then removed there is not written again.
    """
    image = georeference(record)
    if image is None:
        return {}
    photos = _photos(session, record, rows)
    by_gps = placed_by_gps(photos.values(), image)
    wanted = {}
    for id, row in rows.items():
        photo = None if row.photo_id is None else photos.get(row.photo_id)
        if photo is None or not _is_set_here(photo, by_gps) or id not in assets or photo.removed:
            continue
        position = image.latlon_of(MapPixel(float(photo.x_px or 0.0), float(photo.y_px or 0.0)))
        there, last = assets[id].position, _last(row)
        is_ours = row.written and there is not None and last is not None and is_same(there, last)
        is_done = row.written and last is not None and is_same(position, last)
        is_there = there is not None and is_same(there, position)
        if not is_done and (there is None or is_ours or is_there):
            wanted[id] = position
    return wanted


def is_same(one: LatLon, other: LatLon) -> bool:
    return max(abs(one.lat - other.lat), abs(one.lon - other.lon)) <= _SAME_DEG


def _photos(session: Session, record: MapRecord, rows: Mapping[str, LinkedPhoto]) -> dict[int, Photo]:
    ids = {row.photo_id for row in rows.values() if row.photo_id is not None}
    return maps.photos_by_id(session, record, ids)


def _last(row: LinkedPhoto) -> LatLon | None:
    return None if row.lat is None or row.lon is None else LatLon(row.lat, row.lon)


def _is_set_here(photo: Photo, by_gps: Collection[int]) -> bool:
    return photo.x_px is not None and photo.id not in by_gps


def _settle(row: LinkedPhoto, asset: Asset | None) -> None:
    """Note whether a position arrived that an earlier update was writing when it ended."""
    if row.sent_lat is None or row.sent_lon is None or asset is None:
        return
    sent = LatLon(row.sent_lat, row.sent_lon)
    if asset.position is not None and is_same(asset.position, sent):
        row.lat, row.lon, row.written = sent.lat, sent.lon, True
    row.sent_lat = row.sent_lon = None


def _leave(
    row: LinkedPhoto,
    photo: Photo | None,
    *,
    asset: Asset | None,
    by_gps: Collection[int],
    shared: Collection[int],
) -> Changes:
    """Remove a photo that the album no longer has, unless it is from elsewhere, or a person has worked on it.

    Args:
        asset: What the album has instead: another file under the same id, which is fetched afterwards.
        shared: Photos that other linked albums have, too.
    """
    if row.state != HERE or photo is None:
        return {}
    is_worked_on = photo.removed or photo.note or photo.blurred or _is_set_here(photo, by_gps)
    if is_worked_on or photo.id in shared or REMARK not in (photo.file_notes or ()):
        if asset is None:
            row.state = KEPT
        else:
            row.checksum = asset.checksum
        return {}
    row.state = TAKEN
    return {f"photo/{photo.id}": {"removed": True}}


def _return(row: LinkedPhoto, photo: Photo | None) -> Changes:
    """Bring back a photo that was removed because the album did not have it."""
    was_taken, row.state = row.state == TAKEN, HERE
    if not was_taken or photo is None or not photo.removed:
        return {}
    return {f"photo/{photo.id}": {"removed": False}}


def _move(
    record: MapRecord, row: LinkedPhoto, *, photo: Photo | None, asset: Asset, by_gps: Collection[int]
) -> Changes:
    """Take over a position that has changed there, unless a person has placed or removed the photo here."""
    there, last = asset.position, _last(row)
    if there is None or (last is not None and is_same(there, last)):
        return {}
    row.lat, row.lon, row.written = there.lat, there.lon, False
    if photo is None or photo.removed or _is_set_here(photo, by_gps):
        return {}
    had_none = photo.gps_lat is None
    photo.gps_lat, photo.gps_lon, photo.gps_accuracy_m, photo.gps_problem = there.lat, there.lon, None, None
    record.revision += 1
    photo.revision = record.revision
    if photo.x_px is None and not had_none:
        return {}  # in the tray although it had a position: outside the image, or put there by a person
    image = image_of(record)
    if image is None or image.georeference is None:
        return {}
    pixel = image.georeference.pixel_of(there)
    if inside(pixel, width=image.width, height=image.height):
        return {f"photo/{photo.id}": {"x_px": pixel.x, "y_px": pixel.y}}
    if photo.x_px is None:
        return {}
    return {f"photo/{photo.id}": {"x_px": None, "y_px": None, "floor": BASE_FLOOR}}


def _elsewhere(session: Session, rows: Mapping[str, LinkedPhoto]) -> set[int]:
    """Return the photos that several assets have, in this album or in others of the map."""
    album_ids = {row.album_id for row in rows.values()}
    of_map = select(LinkedAlbum.map_id).where(LinkedAlbum.id.in_(album_ids)).scalar_subquery()
    found = (
        select(LinkedPhoto.photo_id)
        .join(LinkedAlbum, LinkedAlbum.id == LinkedPhoto.album_id)
        .where(LinkedAlbum.map_id == of_map, LinkedPhoto.state == HERE, LinkedPhoto.photo_id.is_not(None))
        .group_by(LinkedPhoto.photo_id)
        .having(func.count() > 1)
    )
    return {id for id in session.scalars(found) if id is not None}
