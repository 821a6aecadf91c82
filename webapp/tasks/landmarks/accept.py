"""Accepts suggested places of photos: in the library as one edit, in any other folder in its files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import mode
from typing import TypeVar

from sqlalchemy import select

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, facts_of
from webapp.files.maps.folder import read_map, write_map
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library, has_library, open_library
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.landmarks.place_rest import CorrectedPlace, SuggestedPlace
from webapp.tasks.maps import export
from webapp.tasks.maps.placing import PlacingResult, RequestedPose, find_spots, needed_image, place_spots
from webapp.tasks.operate.open_storage import open_storage

_SAME_PX = 0.1
"""Tolerance in comparisons of positions, which are stored to a hundredth."""

Place = TypeVar("Place", SuggestedPlace, CorrectedPlace)


@contextmanager
def library_of(cfg: Path, *, settings: Settings) -> Iterator[tuple[Library, int] | None]:
    """Open the library that a map file belongs to; yield it with the map's id, or None if there is none.

    The map file is updated first.
    """
    folder = cfg.resolve().parent
    if cfg.name != "map.cfg" or not has_library(folder.parent):
        yield None
        return
    library = open_library(folder.parent, url=settings.database)
    try:
        open_storage(library, settings)
        with library.database.read() as session:
            found = session.scalar(select(MapRecord.id).where(MapRecord.slug == folder.name))
        if found is not None:
            export.export_map(library, found)
        yield None if found is None else (library, found)
    finally:
        library.database.close()


def owner_of(library: Library) -> int:
    """Return the id of the account of the library's owner."""
    with library.database.write() as session:
        return accounts.ensure_owner(session).id


def accept_in_library(
    library: Library, map_id: int, *, suggested: Iterable[SuggestedPlace], account_id: int
) -> PlacingResult:
    """Place photos where suggested, as one edit; photos that were placed meanwhile are skipped.

    Raises:
        UsageError: The map no longer has a satellite image.
    """
    with library.changing(map_id) as change:
        pairs = [(photo, place) for photo, place in _photos_of(change, suggested) if photo.x_px is None]
        others = {id for _, place in pairs for id in place.placed_by}
        floors = {
            id: photo.floor for id, photo in maps.photos_by_id(change.session, change.record, others).items()
        }
        wanted = [replace(_pose(photo, place), floor=_floor_of(place, floors)) for photo, place in pairs]
        placing = _place(change, wanted, account_id=account_id)
    return replace(placing, job=change.job)


def correct_in_library(
    library: Library, map_id: int, *, corrected: Iterable[CorrectedPlace], account_id: int
) -> PlacingResult:
    """Move photos from their GPS positions to the corrected ones, as one edit; skip those moved meanwhile.

    Parameters and errors are those of `accept_in_library`.
    """
    with library.changing(map_id) as change:
        wanted = [
            _pose(photo, place)
            for photo, place in _photos_of(change, corrected)
            if is_where_it_was(photo, place.before)
        ]
        placing = _place(change, wanted, account_id=account_id)
    return replace(placing, job=change.job)


def is_where_it_was(photo: Photo, before: MapPixel) -> bool:
    """Return whether a photo is still at the position `before` for which its correction was computed."""
    return (
        photo.x_px is not None
        and photo.y_px is not None
        and _is_near(MapPixel(photo.x_px, photo.y_px), before)
    )


def _is_near(one: MapPixel, other: MapPixel) -> bool:
    return math.dist(one, other) < _SAME_PX


def _photos_of(change: MapChange, places: Iterable[Place]) -> list[tuple[Photo, Place]]:
    """Pair places with their photos, except photos that were removed meanwhile."""
    by_id = {one.id: one for one in places}
    photos = maps.photos_by_id(change.session, change.record, by_id)
    return [(photo, by_id[id]) for id, photo in photos.items() if not photo.removed]


def _pose(photo: Photo, place: SuggestedPlace | CorrectedPlace) -> RequestedPose:
    return RequestedPose(photo, MapPixel(*place.position), place.heading_deg, place.radius_px)


def _floor_of(place: SuggestedPlace, floors: Mapping[int, int]) -> int:
    """Return the most frequent floor of the photos by which it was placed."""
    by = [floors[id] for id in place.placed_by if id in floors]
    return mode(by) if by else BASE_FLOOR


def _place(change: MapChange, wanted: Sequence[RequestedPose], *, account_id: int) -> PlacingResult:
    image = needed_image(change.record, with_georeference=False)
    spots = find_spots(image, wanted)
    return place_spots(change.session, change.record, spots=spots, kind="place-rest", account_id=account_id)


def accept_in_folder(cfg: Path, suggested: Sequence[SuggestedPlace]) -> None:
    """Place photos where suggested, in the files of a map outside a library.

    Raises MapError, StorageError.
    """
    the_map = read_map(cfg)
    places = {one.id: one for one in suggested}
    floors = {e.id: e.floor for e in the_map.experiences}
    placed = [
        Experience(
            photo.id,
            photo.photo,
            places[photo.id].position,
            radius_px=places[photo.id].radius_px,
            floor=_floor_of(places[photo.id], floors),
            **{**facts_of(photo), "heading_deg": places[photo.id].heading_deg},
        )
        for photo in the_map.unplaced
        if photo.id in places
    ]
    everyone = tuple(sorted((*the_map.experiences, *placed), key=lambda e: e.id))
    changed = replace(the_map, experiences=everyone)
    # photos leave the tray only once the `.cfg` has them: if killed in between, none is lost
    write_map(cfg, changed)
    write_map(cfg, replace(changed, unplaced=tuple(p for p in the_map.unplaced if p.id not in places)))


def correct_in_folder(cfg: Path, corrected: Sequence[CorrectedPlace]) -> None:
    """Move photos from their GPS positions to the corrected ones, in the files of a map outside a library.

    Raises MapError, StorageError.
    """
    the_map = read_map(cfg)
    places = {one.id: one for one in corrected}
    experiences = tuple(_moved(e, places) for e in the_map.experiences)
    moved = {new.id for old, new in zip(the_map.experiences, experiences, strict=True) if new is not old}
    write_map(cfg, replace(the_map, experiences=experiences), from_gps=moved)


def _moved(e: Experience, places: Mapping[int, CorrectedPlace]) -> Experience:
    place = places.get(e.id)
    if place is None or not e.by_gps or not _is_near(e.position, place.before):
        return e
    heading = e.heading_deg if place.heading_deg is None else place.heading_deg
    return replace(e, position=place.position, heading_deg=heading, by_gps=False, radius_px=place.radius_px)
