"""Blurs parts of a photo in every picture of it that is shown; the file itself stays as it came."""

from __future__ import annotations

import math
from collections.abc import Sequence

from webapp.core.blur import BlurBox
from webapp.errors import UsageError
from webapp.files.part_file import told_as
from webapp.files.photos.preview import make_previews, write_previews
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps import show_photo

MOST_BOXES = 50

_ROUNDING = 1e-6
"""Shares that were computed may be so much too large."""


def blur_photo(
    library: Library, map_id: int, *, photo_id: int, boxes: Sequence[BlurBox], settings: Settings
) -> int | None:
    """Blur these parts of a photo, and no others.

    The pictures are there before the record says so: nobody is shown an old one as the new one.

    Returns
    -------
    int or None
        New revision of the map; None when they were blurred already.

    Raises
    ------
    UsageError
        A box is none, or there are too many.
    NotFound, PhotoError, StorageError
    """
    wanted = [_checked(box) for box in boxes]
    if len(wanted) > MOST_BOXES:
        raise UsageError(f"{len(wanted)} boxes", where="boxes", hint=f"at most {MOST_BOXES}")
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        photo = maps.photo(session, record, photo_id)
    if show_photo.boxes_of(photo) == wanted:
        return None
    source = show_photo.original(library, record.slug, photo=photo)
    with told_as(photo.name, source):
        previews = make_previews(source, limits=settings.photo, blurred=wanted)
    with library.changing(map_id) as change:
        record = change.record
        photo = maps.photo(change.session, record, photo_id)
        write_previews(library.map_folder(record.slug), photo_id, previews=previews)
        photo.blurred = [box._asdict() for box in wanted] or None
        record.revision += 1
        record.changed_at = now()
        photo.revision = record.revision
        return record.revision


def _checked(box: BlurBox) -> BlurBox:
    most = 1 + _ROUNDING
    inside = all(math.isfinite(value) for value in box) and min(box.x, box.y) >= 0
    if not inside or min(box.width, box.height) <= 0 or max(box.x + box.width, box.y + box.height) > most:
        raise UsageError(
            "a box lies outside the photo", where="boxes", hint="shares of its width and height, from 0 to 1"
        )
    return box
