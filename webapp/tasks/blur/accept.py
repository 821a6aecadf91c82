"""Accepts suggested blur boxes: in the library photo by photo, in any other folder in its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from webapp.core.boxes import MOST_BOXES, BlurBox
from webapp.core.detections import is_hidden
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.errors import Conflict, MapError, NotFound, PhotoError
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.schema import MapRecord
from webapp.tasks.blur.find import SuggestedBoxes, UnsearchedPhoto
from webapp.tasks.maps.show_photo import Changing, NewBlur, blur_photo

Photo = TypeVar("Photo", Experience, UnplacedPhoto)


def accept_in_library(
    library: Library,
    map_id: int,
    *,
    suggested: Iterable[SuggestedBoxes],
    settings: Settings,
    progress: Progress,
    changing: Changing | None = None,
) -> tuple[list[int], list[UnsearchedPhoto]]:
    """Add suggested blur boxes photo by photo; boxes added meanwhile are kept, and nothing is blurred twice.

    Args:
        changing: Opens a change of a map, instead of `library.changing`; a job passes its own.

    Returns:
        blurred: Ids of the photos that have new boxes.
        failed:

    Raises:
        Conflict: The boxes of a photo were changed concurrently, twice, or another worker has taken over the
            job.
        StorageError, Busy, Cancelled
    """
    wanted, blurred, failed = list(suggested), [], []
    progress.size(len(wanted))
    for one in wanted:
        progress.check()
        try:
            done = _accept(library, map_id, one, settings=settings, changing=changing)
        except (PhotoError, MapError, NotFound) as error:
            failed.append(UnsearchedPhoto(one.id, one.photo, error.message))
        else:
            blurred += [one.id] if done else []
        progress.advance()
    return blurred, failed


def _accept(
    library: Library, map_id: int, one: SuggestedBoxes, *, settings: Settings, changing: Changing | None
) -> bool:
    """Add the suggested boxes to a photo; retry once if its boxes were changed concurrently."""
    try:
        return _blur(library, map_id, one, settings=settings, changing=changing)
    except Conflict:  # also if another worker has taken over the job: then the retry raises it again
        return _blur(library, map_id, one, settings=settings, changing=changing)


def _blur(
    library: Library, map_id: int, one: SuggestedBoxes, *, settings: Settings, changing: Changing | None
) -> bool:
    """Add the suggested boxes to a photo unless it was removed; return whether anything changed."""
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        photo = maps.photos_by_id(session, record, [one.id]).get(one.id)
    if photo is None or photo.removed:
        return False
    before = boxes_of(photo)
    wanted = NewBlur([*before, *_new(one, before)], seen=before)
    revision = blur_photo(
        library, map_id, photo_id=one.id, wanted=wanted, settings=settings, changing=changing
    )
    return revision is not None


def accept_in_folder(cfg: Path, suggested: Iterable[SuggestedBoxes]) -> list[int]:
    """Add suggested blur boxes to the photos of a map outside a library. Raises MapError, StorageError.

    Returns:
        Ids of the photos that have new boxes.
    """
    by_id = {one.id: one for one in suggested}
    the_map = read_map(cfg)
    experiences = tuple(_blurred(e, by_id) for e in the_map.experiences)
    unplaced = tuple(_blurred(p, by_id) for p in the_map.unplaced)
    changed = _changed(the_map.experiences, experiences) + _changed(the_map.unplaced, unplaced)
    if changed:
        write_map(cfg, replace(the_map, experiences=experiences, unplaced=unplaced))
    return changed


def _changed(before: Sequence[Photo], after: Sequence[Photo]) -> list[int]:
    return [now.id for then, now in zip(before, after, strict=True) if now is not then]


def _blurred(photo: Photo, by_id: Mapping[int, SuggestedBoxes]) -> Photo:
    new: list[BlurBox] = _new(by_id[photo.id], photo.blurred) if photo.id in by_id else []
    return replace(photo, blurred=(*photo.blurred, *new)) if new else photo


def _new(suggested: SuggestedBoxes, blurred: Sequence[BlurBox]) -> list[BlurBox]:
    """Return the suggested boxes that are not blurred yet, up to the limit per photo."""
    boxes = [one.box for one in suggested.boxes if not is_hidden(one.box, blurred)]
    return boxes[: max(0, MOST_BOXES - len(blurred))]
