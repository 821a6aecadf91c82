"""Gives the pictures and the original file of a photo to somebody; access is checked by the caller.

Boxes follow the content: whatever is blurred in a photo of a map is blurred in the same file on other maps
and missions, in the answer from which it was adopted, and among the examples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy.orm import Session

from webapp.core.boxes import BlurBox
from webapp.errors import NotFound
from webapp.files.part_file import show_file_as
from webapp.files.photos.photo import Kind, blur_key, make_previews, preview_name, write_previews
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps.blurred import boxes_of, boxes_of_files
from webapp.store.schema import Photo

NOT_SHARED = "original files are not shared here"

Audience = Literal["members", "visitors"]
"""Who looks: people with a role on the map or mission, or anyone else, including recipients of an export."""


@dataclass(frozen=True, slots=True)
class PhotoFile:
    """A photo, wherever it is stored."""

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
