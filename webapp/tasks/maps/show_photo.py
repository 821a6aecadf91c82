"""Finds a photo's file or preview, for those who may see it, and blurs parts of it in all its previews."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from webapp.core.blur import BlurBox
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import show_file_as
from webapp.files.photos.preview import Kind, look_of, make_previews, preview_path, write_previews
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord, Photo

MOST_BOXES = 500

Changing = Callable[[int], AbstractContextManager[MapChange]]


class NewBlur(NamedTuple):
    """What is to be blurred in a photo.

    Attributes
    ----------
    boxes : sequence of BlurBox
        All of it.
    seen : sequence of BlurBox or None
        What was blurred when it was chosen; None to replace whatever is blurred now.
    """

    boxes: Sequence[BlurBox]
    seen: Sequence[BlurBox] | None = None


def original(library: Library, slug: str, *, photo: Photo) -> Path:
    """Find the original file of a photo.

    Raises
    ------
    NotFound
        It is missing on the disk.
    MapError
        Its path, or a link on the way, leads out of the map's folder.
    """
    cfg = library.cfg(slug)
    with show_file_as(photo.name, cfg):
        path = photo_path(cfg, photo.path)
    if not path.is_file():
        raise NotFound("the file of this photo is missing", where=photo.name, hint="upload it again")
    return path


def boxes_of(photo: Photo) -> list[BlurBox]:
    """List what is blurred in the pictures of a photo."""
    return [BlurBox(**box) for box in photo.blurred or ()]


def look_of_photo(photo: Photo) -> str | None:
    """Return a key of what is blurred in a photo; None where nothing is."""
    return look_of(boxes_of(photo))


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
    folder, boxes = library.map_folder(slug), boxes_of(photo)
    path = preview_path(folder, photo.id, kind=kind, blurred=boxes)
    if not path.exists():
        source = original(library, slug, photo=photo)
        with show_file_as(photo.name, source):
            made = make_previews(source, limits=settings.photo, blurred=boxes)
        write_previews(folder, photo.id, previews=made, blurred=boxes)
    return path


def blur_photo(
    library: Library,
    map_id: int,
    *,
    photo_id: int,
    wanted: NewBlur,
    settings: Settings,
    changing: Changing | None = None,
) -> int | None:
    """Blur these parts of a photo, and no others.

    The pictures are there before the record says so: nobody is shown an old one as the new one.

    Parameters
    ----------
    changing : callable, optional
        Changes a map, instead of `library.changing`: that of a job.

    Returns
    -------
    int or None
        New revision of the map; None when they were blurred already.

    Raises
    ------
    UsageError
        A box is not valid, or there are too many.
    Conflict
        Somebody else has blurred it at the same time, or since these boxes were chosen; nothing was changed.
    NotFound, PhotoError, StorageError
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
        write_previews(library.map_folder(record.slug), photo_id, previews=previews, blurred=boxes)
        photo.blurred = [box._asdict() for box in boxes] or None
        record.revision += 1
        record.changed_at = now()
        photo.revision = record.revision
        if photo.is_placed:
            record.photos_revision = record.revision  # nothing is recognised by what is blurred now
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
