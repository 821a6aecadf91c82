"""Takes a photo that a visitor gives to a map into its tray, with the place that localization suggests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import mode
from typing import Any

from sqlalchemy import select

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.errors import Conflict, NotFound, TooMany, UsageError
from webapp.files.part_file import sha256_of
from webapp.settings import ContributionSettings, Settings
from webapp.store import contributions
from webapp.store.contributions import Amount
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import Contribution, Photo, Share
from webapp.tasks.maps.add_photo import IncomingPhoto, add_photo
from webapp.tasks.maps.placing import RequestedPose, find_spots, needed_image, place_spots

_DAY_S = 86_400
_PLACE = ("x_px", "y_px", "radius_px", "heading_deg", "probability")


@dataclass(frozen=True, slots=True)
class Given:
    """A photo from a visitor."""

    share_id: int
    visitor: str  # As `contributions.visitor_of` makes it
    file: Path  # In the uploads folder; it is moved or deleted
    name: str


def check_allowance(
    library: Library, share: Share, *, visitor: str, size_bytes: int, limits: ContributionSettings
) -> None:
    """Check that a visitor may give a photo of this size.

    Raises:
        UsageError: It is too large.
        TooMany: The visitor has given enough on this day, or too many photos of the map wait.
    """
    with library.database.read() as session:
        today = contributions.of_visitor(session, visitor)
        waiting = contributions.waiting_amount(session, share.map_id)
    _check(size_bytes, today=today, waiting=waiting, limits=limits)


def _check(size_bytes: int, *, today: Amount, waiting: Amount, limits: ContributionSettings) -> None:
    if size_bytes > limits.max_mb * 1e6:
        raise UsageError(
            f"the photo has more than {limits.max_mb:g} MB", where="file", hint="send a smaller copy"
        )
    if today.photos >= limits.photos_per_day or today.bytes + size_bytes > limits.mb_per_day * 1e6:
        raise TooMany(
            f"you have sent {today.photos} photos today, which is enough for now",
            wait_s=_DAY_S,
            hint="come back tomorrow",
        )
    if waiting.photos >= limits.waiting_photos or waiting.bytes + size_bytes > limits.waiting_mb * 1e6:
        raise TooMany(
            "too many photos wait for the owners of this map",
            wait_s=_DAY_S,
            hint="come back when they have looked at them",
        )


def contribute(
    library: Library, map_id: int, *, given: Given, place: Mapping[str, Any] | None, settings: Settings
) -> int:
    """Take in a photo, and return its id: all of it is kept, or nothing.

    Args:
        place: The first hypothesis of an answer, if the photo is probably on the map.

    Raises:
        Conflict: The map has this photo, or had it.
        PhotoError: As for `add_photo`.
        NotFound: The link was revoked, or the map is gone.
        UsageError, TooMany: As for `check_allowance`.
        DiskFull, StorageError: The disk or the object storage failed.
    """
    sha256, size_bytes = sha256_of(given.file), given.file.stat().st_size

    @contextmanager
    def changing(map_id: int) -> Iterator[MapChange]:
        with library.changing(map_id) as change:
            session = change.session
            share = session.get(Share, given.share_id)
            if share is None or not share.contribute:
                raise NotFound("photos cannot be given here", hint="ask the person who sent the link")
            same = select(Photo.id).where(Photo.map_id == map_id, Photo.sha256 == sha256)
            if session.scalars(same).first() is not None:
                raise Conflict("this photo has been sent before", hint="choose another one")
            _check(
                size_bytes,
                today=contributions.of_visitor(session, given.visitor),
                waiting=contributions.waiting_amount(session, map_id),
                limits=settings.contributions,
            )
            yield change
            session.flush()
            values = {name: None if place is None else place.get(name) for name in _PLACE}
            session.add(
                Contribution(
                    map_id=map_id,
                    photo_id=session.scalars(same).one(),
                    share_id=given.share_id,
                    visitor=given.visitor,
                    size_bytes=size_bytes,
                    floor=_floor(change, () if place is None else place["experiences"]),
                    **values,
                )
            )

    photo = IncomingPhoto(given.file, given.name)
    return add_photo(library, map_id, photo=photo, settings=settings, by_gps=False, changing=changing).id


def accept(library: Library, map_id: int, *, photo_id: int, account_id: int) -> None:
    """Place a photo where localization suggests, as one edit that can be undone.

    Raises:
        NotFound: It does not wait any more.
        UsageError: No place is suggested, or the map has no image.
    """
    with library.changing(map_id) as change:
        given, photo = contributions.find_waiting(change.session, change.record, photo_id)
        if given.x_px is None or given.y_px is None:
            raise UsageError("no place is suggested for this photo", hint="place it in the editor")
        position = MapPixel(given.x_px, given.y_px)
        pose = RequestedPose(photo, position, given.heading_deg, given.radius_px, given.floor)
        spots = find_spots(needed_image(change.record, with_georeference=False), [pose])
        place_spots(change.session, change.record, spots=spots, kind="place", account_id=account_id)


def _floor(change: MapChange, ids: Sequence[int]) -> int:
    """Return the most frequent floor of the photos behind a place."""
    floors = [photo.floor for photo in maps.photos_by_id(change.session, change.record, ids).values()]
    return mode(floors) if floors else BASE_FLOOR
