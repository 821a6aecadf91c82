"""The level views of a map's panoramas, in their places: what an index has."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.core.mapmodel.panorama import view_id

OnePhoto = TypeVar("OnePhoto", bound=Experience | UnplacedPhoto)


def level_views(photos: Iterable[OnePhoto]) -> tuple[OnePhoto, ...]:
    """Put the level views of panoramas in their places, with ids and headings of their own."""
    return tuple(one for photo in photos for one in _views(photo))


def picture_of(photo: Experience | UnplacedPhoto) -> str:
    """Return the name of a photo's file, and which view of it this is."""
    return photo.photo if photo.view is None else f"{photo.photo}#{photo.view.key}"


def content_of(photo: Experience | UnplacedPhoto, sha256: str) -> str:
    """Return what stands for the pixels of a photo, or of a view, whose file has that SHA-256."""
    return sha256 if photo.view is None else photo.view.content(sha256)


def _views(photo: OnePhoto) -> Iterator[OnePhoto]:
    if photo.panorama is None:
        yield photo
        return
    middle = photo.heading_deg
    for number, view in enumerate(photo.panorama.views()):
        heading = None if middle is None else (middle + view.turn_deg) % 360.0
        id = view_id(photo.id, number)
        yield replace(photo, id=id, heading_deg=heading, fov_deg=None, panorama=None, view=view)
