"""Finds the file of a photo, or of a preview, for those who may see it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from webapp.core.blur import BlurBox
from webapp.errors import NotFound
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import told_as
from webapp.files.photos.preview import Kind, make_previews, preview_path, write_previews
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import Photo


def original(library: Library, slug: str, *, photo: Photo) -> Path:
    """Find the file of a photo, as it came.

    Raises
    ------
    NotFound
        It is missing on the disk.
    MapError
        Its path, or a link on the way, leads out of the map's folder.
    """
    cfg = library.cfg(slug)
    with told_as(photo.name, cfg):
        path = photo_path(cfg, photo.path)
    if not path.is_file():
        raise NotFound("the file of this photo is missing", where=photo.name, hint="upload it again")
    return path


def boxes_of(photo: Photo) -> list[BlurBox]:
    """List what is blurred in the pictures of a photo."""
    return [BlurBox(**box) for box in photo.blurred or ()]


def look_of(photo: Photo) -> str | None:
    """Give a word that changes with what is blurred; None where nothing is."""
    boxes = boxes_of(photo)
    return hashlib.sha256(repr(boxes).encode()).hexdigest()[:12] if boxes else None


def preview(library: Library, slug: str, *, photo: Photo, kind: Kind, settings: Settings) -> Path:
    """Find a preview of a photo, and make it where it is missing.

    Raises
    ------
    NotFound, PhotoError
        The photo is missing or damaged.
    MapError
        Its path, or a link on the way, leads out of the map's folder.
    StorageError
        The disk refused.
    """
    folder = library.map_folder(slug)
    path = preview_path(folder, photo.id, kind=kind)
    if not path.exists():
        source = original(library, slug, photo=photo)
        with told_as(photo.name, source):
            made = make_previews(source, limits=settings.photo, blurred=boxes_of(photo))
        write_previews(folder, photo.id, previews=made)
    return path
