"""Takes a photo that a visitor gives to a map into its tray, with the place that localization suggests."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import mode
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.errors import (
    Conflict,
    ExpMapError,
    IndexDamaged,
    NotFound,
    NotReady,
    PhotoError,
    RetryLater,
    TooMany,
    UsageError,
)
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import sha256_of
from webapp.progress import Progress
from webapp.settings import ContributionSettings, Settings
from webapp.store import contributions
from webapp.store.contributions import Amount
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import Contribution, MapRecord, Photo, Share
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto
from webapp.tasks.maps.add_photo import IncomingPhoto, add_photo
from webapp.tasks.maps.placing import RequestedPose, find_spots, needed_image, place_spots

_log = logging.getLogger(__name__)
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


@dataclass(frozen=True, slots=True)
class Suggestion:
    """Where localization suggests that a photo was taken."""

    place: Mapping[str, Any] | None = None  # The first hypothesis of an answer, if it probably is on the map
    to_find: bool = False  # The map cannot be asked now, and is asked when it has an index


def suggest(cache: MapCache, map_id: int, *, photo: UploadedPhoto) -> Suggestion:
    """Ask the map for the place of a photo; with an index that is not ready, it is found later.

    Raises:
        PhotoError: It cannot be used.
    """
    try:
        request = LocalizeRequest((photo,), top=1)
        form = upload.localize_uploads(cache, map_id, request=request).form
    except PhotoError:
        raise
    except ExpMapError as error:  # the photo waits all the same: people can place it
        _log.info("no place is suggested for a visitor's photo: %s", error)
        return Suggestion(to_find=isinstance(error, (NotReady, IndexDamaged, RetryLater)))
    first = next(iter(form["hypotheses"]), None)
    if first is None or first["x_px"] is None or first["probability"] <= form["off_map_probability"]:
        return Suggestion()
    return Suggestion(first)


def suggest_later(
    cache: MapCache,
    map_id: int,
    *,
    write: Callable[[], AbstractContextManager[Session]],
    progress: Progress,
) -> int:
    """Find the places of photos that were given while the map had no index; return their number.

    Each is stored by itself, so that a run that was killed goes on with the others.
    """
    library = cache.library
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        waiting = [photo for _given, photo in contributions.to_find(session, record)]
    if waiting:
        progress.note("finding the places of photos from visitors")
    for photo in waiting:
        progress.check()
        file = photo_path(library.cfg(record.slug), photo.path)
        try:
            found = suggest(cache, map_id, photo=UploadedPhoto(file, photo.name))
        except PhotoError as error:
            _log.warning("no place is suggested for a visitor's photo: %s", error)
            found = Suggestion()
        if found.to_find:
            return 0  # other features than those of this index are used
        with write() as session:
            given = session.get(Contribution, (map_id, photo.id))
            if given is not None:
                _note(session, record, given=given, found=found)
    return len(waiting)


def contribute(
    library: Library, map_id: int, *, given: Given, suggestion: Suggestion, settings: Settings
) -> int:
    """Take in a photo, and return its id: all of it is kept, or nothing.

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
            row = Contribution(
                map_id=map_id,
                photo_id=session.scalars(same).one(),
                share_id=given.share_id,
                visitor=given.visitor,
                size_bytes=size_bytes,
            )
            _note(session, change.record, given=row, found=suggestion)
            session.add(row)

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


def _note(session: Session, record: MapRecord, *, given: Contribution, found: Suggestion) -> None:
    """Note a suggested place, and its floor: the most frequent one of the photos behind it."""
    given.to_find = found.to_find
    if found.place is None:
        return
    for name in _PLACE:
        setattr(given, name, found.place.get(name))
    behind = maps.photos_by_id(session, record, found.place["experiences"]).values()
    given.floor = mode([photo.floor for photo in behind] or [BASE_FLOOR])
