"""Pictures as they are indexed: photos without their blurred parts, and level views of panoramas."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

from webapp.core.boxes import BlurBox, boxes_key
from webapp.core.mapmodel.model import MapPhoto
from webapp.core.mapmodel.panorama import LevelView, view_id

OnePhoto = TypeVar("OnePhoto", bound=MapPhoto)


def level_views(photos: Iterable[OnePhoto]) -> tuple[OnePhoto, ...]:
    """Replace panoramas by their level views, which have ids and headings of their own."""
    return tuple(one for photo in photos for one in _views(photo))


def picture_name(photo: MapPhoto) -> str:
    """Return the name of a photo's file, with a key of the used part: a view, or all but blurred boxes."""
    if photo.view is not None:
        return f"{photo.photo}#{photo.view.key}"
    return photo.photo if not photo.blurred else f"{photo.photo}#{boxes_key(photo.blurred)}"


def content_of(photo: MapPhoto, sha256: str) -> str:
    """Return a hash that identifies the used pixels of a photo whose file has that SHA-256."""
    return content_of_part(sha256, view=photo.view, blurred=photo.blurred)


def content_of_part(sha256: str, *, view: LevelView | None, blurred: tuple[BlurBox, ...]) -> str:
    """Return a hash that identifies a view, or the part that is not blurred, of a file with that SHA-256."""
    if view is not None:
        return view.content(sha256)
    return sha256 if not blurred else hashlib.sha256(f"{sha256} {boxes_key(blurred)}".encode()).hexdigest()


def _views(photo: OnePhoto) -> Iterator[OnePhoto]:
    if photo.panorama is None:
        yield photo
        return
    middle = photo.heading_deg
    masked = replace(photo.panorama, masked=photo.panorama.masked + photo.blurred)
    for number, view in enumerate(masked.views()):
        heading = None if middle is None else (middle + view.turn_deg) % 360.0
        id = view_id(photo.id, number)
        yield replace(photo, id=id, heading_deg=heading, fov_deg=None, panorama=None, view=view)
