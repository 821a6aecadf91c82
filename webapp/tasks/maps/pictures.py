"""Gives the pictures and the file of a photo to somebody; access is checked by the caller.

Boxes follow the content: whatever is blurred in a photo of a map is blurred in the same file on other maps
and missions, in the answer from which it was adopted, and among the examples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

from sqlalchemy.orm import Session

from webapp.core.boxes import MOST_BOXES, BlurBox
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import show_file_as
from webapp.files.photos.photo import (
    Kind,
    blur_key,
    make_previews,
    preview_name,
    previews_folder,
    write_previews,
)
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of, boxes_of_files, release_boxes
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord, Photo

NOT_SHARED = "original files are not shared here"

Audience = Literal["members", "visitors"]
"""Who looks: people with a role on the map or mission, or anyone else, including recipients of an export."""


@dataclass(frozen=True, slots=True)
class PhotoFile:
    name: str  # Name of the original file, for errors
    sha256: str
    find: Callable[[], Path]  # Returns the path of the original file, or raises `NotFound`
    previews: Path  # Folder of its previews
    stem: str  # Beginning of their names
    # For a photo of a map, the boxes of its own record: members see only these blurred.
    on_map: tuple[BlurBox, ...] | None = None
    # For the photo of an answer, ids of map and photo that it has become.
    adopted: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Picture:
    """A preview, and a key that changes with its content."""

    path: Path
    etag: str


def boxes_for(
    session: Session, photos: Sequence[PhotoFile], *, audience: Audience
) -> list[tuple[BlurBox, ...]]:
    found = boxes_of_files(session, (photo.sha256 for photo in photos))
    return [
        photo.on_map
        if photo.on_map is not None and audience == "members"
        else _everywhere(session, photo, found.get(photo.sha256, ()))
        for photo in photos
    ]


def give_picture(
    library: Library, photo: PhotoFile, *, kind: Kind, audience: Audience, settings: Settings
) -> Picture:
    """Return a preview of a photo with its boxes blurred, which is created on first use.

    Raises:
        NotFound, PhotoError: The photo is missing or damaged.
        MapError: Its path leads out of the map's folder, perhaps by a link.
        StorageError: The file cannot be written.
    """
    with library.database.read() as session:
        (boxes,) = boxes_for(session, [photo], audience=audience)
    path = photo.previews / preview_name(photo.stem, kind, blurred=boxes)
    if not path.exists():
        source = photo.find()
        with show_file_as(photo.name, source):
            made = make_previews(source, limits=settings.photo, blurred=boxes)
        write_previews(photo.previews, photo.stem, previews=made, blurred=boxes)
    return Picture(path, f"{photo.sha256}-{kind}-{blur_key(boxes)}")


def give_original(library: Library, photo: PhotoFile, *, audience: Audience) -> Path:
    """Return the original file of a photo; visitors do not get that of a blurred one.

    Raises:
        NotFound: It is missing, or not for visitors.
        MapError: Its path leads out of the map's folder, perhaps by a link.
    """
    if audience == "visitors":
        with library.database.read() as session:
            (boxes,) = boxes_for(session, [photo], audience=audience)
        if boxes:
            raise NotFound(NOT_SHARED)
    return photo.find()


def _everywhere(session: Session, photo: PhotoFile, same: tuple[BlurBox, ...]) -> tuple[BlurBox, ...]:
    row = None if photo.adopted is None else session.get(Photo, photo.adopted)
    adopted = () if row is None else boxes_of(row)
    return tuple(dict.fromkeys((*(photo.on_map or ()), *adopted, *same)))


Changing = Callable[[int], AbstractContextManager[MapChange]]


class NewBlur(NamedTuple):
    """Requested blurring of a photo."""

    boxes: Sequence[BlurBox]  # The complete new list of boxes
    # The boxes that were blurred when these were chosen; None to overwrite without a check.
    seen: Sequence[BlurBox] | None = None


def original(library: Library, slug: str, *, photo: Photo) -> Path:
    cfg = library.cfg(slug)
    with show_file_as(photo.name, cfg):
        path = photo_path(cfg, photo.path)
    if not path.is_file():
        raise NotFound("the file of this photo is missing", where=photo.name, hint="upload it again")
    return path


def file_of(library: Library, slug: str, *, photo: Photo) -> PhotoFile:
    return PhotoFile(
        photo.name,
        photo.sha256,
        partial(original, library, slug, photo=photo),
        previews_folder(library.map_folder(slug)),
        str(photo.id),
        on_map=tuple(boxes_of(photo)),
    )


def boxes_in_exports(library: Library, map_id: int, *, photo_id: int) -> tuple[BlurBox, ...]:
    """Return the boxes to blur in a photo of a map for those who receive an export."""
    with library.database.read() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("map not found")
        photo = maps.photo(session, record, photo_id)
        (boxes,) = boxes_for(session, [file_of(library, record.slug, photo=photo)], audience="visitors")
        return boxes


def blur_photo(
    library: Library,
    map_id: int,
    *,
    photo_id: int,
    wanted: NewBlur,
    settings: Settings,
    changing: Changing | None = None,
) -> int | None:
    """Replace the blurred boxes of a photo; return the revision of the map, None if nothing changed.

    The previews are written before the record is committed, so that an old one is never shown as the new one.

    Args:
        changing: Used instead of `library.changing`, such as that of a job.

    Raises:
        UsageError: A box is not valid, or there are too many.
        Conflict: The boxes were changed concurrently, or since `wanted.seen`; nothing was changed.
    """
    boxes = [_checked(box) for box in wanted.boxes]
    if len(boxes) > MOST_BOXES:
        raise UsageError(f"{len(boxes)} boxes", where="boxes", hint=f"at most {MOST_BOXES}")
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        photo = maps.photo(session, record, photo_id)
    before = boxes_of(photo)
    if before == boxes:
        return None
    if wanted.seen is not None and before != list(wanted.seen):
        raise _blurred_by_another(photo)
    source = original(library, record.slug, photo=photo)
    with show_file_as(photo.name, source):
        previews = make_previews(source, limits=settings.photo, blurred=boxes)
    with (changing or library.changing)(map_id) as change:
        record = change.record
        photo = maps.photo(change.session, record, photo_id)
        if boxes_of(photo) != before:
            raise _blurred_by_another(photo)
        folder = previews_folder(library.map_folder(record.slug))
        write_previews(folder, str(photo_id), previews=previews, blurred=boxes)
        photo.blurred = [box._asdict() for box in boxes] or None
        release_boxes(change.session, photo)
        record.revision += 1
        record.changed_at = now()
        photo.revision = record.revision
        if photo.is_placed:
            record.photos_revision = record.revision  # the index must drop features in the blurred parts
        return record.revision


def _blurred_by_another(photo: Photo) -> Conflict:
    return Conflict(
        "other parts of this photo have been blurred meanwhile", where=photo.name, hint="open it again"
    )


def _checked(box: BlurBox) -> BlurBox:
    if not box.inside:
        raise UsageError(
            "a box lies outside the photo", where="boxes", hint="shares of its width and height, from 0 to 1"
        )
    return box
