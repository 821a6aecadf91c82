"""Detects faces and number plates that are not blurred yet, keeps what was found, and blurs what is accepted.

Detections are stored in the map's folder, one line per searched photo, identified by its SHA-256, so that no
photo is searched twice. Lines are only appended, so that a killed process loses one photo at most.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from filelock import FileLock, Timeout

from webapp.core.boxes import MOST_BOXES, BlurBox
from webapp.core.detections import Detection, boxes_to_blur, is_hidden, merge_duplicates, never
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.errors import Conflict, MapError, MissingPart, NotFound, PhotoError, StorageError
from webapp.files.atomic import make_folder, storage_error
from webapp.files.listing import DERIVED
from webapp.files.localize.models import BlurNetworks
from webapp.files.maps.folder import photo_path, read_map, write_map
from webapp.files.part_file import show_file_as
from webapp.files.photos.photo import SIDES, read_in_turn
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import boxes_of
from webapp.store.schema import MapRecord
from webapp.tasks.maps.pictures import Changing, NewBlur, blur_photo

_WAIT_S = 20.0


class DetectionCache:
    """Stored detections of a map's photos."""

    def __init__(self, map_folder: Path, key: str) -> None:
        self._path = map_folder / DERIVED / "blur" / f"{key}.jsonl"

    def read(self) -> dict[str, list[Detection]]:
        """Read the detections by the SHA-256 of the photo; the list is empty where nothing was found.

        Raises StorageError.
        """
        try:
            lines = self._path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise StorageError(f"cannot be read: {error.strerror}", where=self._path.name) from error
        found: dict[str, list[Detection]] = {}
        for line in lines:
            try:
                one = json.loads(line)
                found[one["photo"]] = [Detection(k, BlurBox(*box), score) for k, box, score in one["found"]]
            except (ValueError, KeyError, TypeError):
                continue  # cut off when a process was killed; the photo is searched again
        return found

    def add(self, sha256: str, found: Sequence[Detection]) -> None:
        """Append the detections of a photo; they are on the disk on return. Raises StorageError."""
        line = json.dumps({"photo": sha256, "found": [[d.kind, list(d.box), d.score] for d in found]})
        make_folder(self._path.parent)
        try:
            lock = FileLock(self._path.with_suffix(".lock"), timeout=_WAIT_S)
            with lock, self._path.open("ab") as file:
                file.write(b"\n" + line.encode())  # the newline ends a line that was cut off
                file.flush()
                os.fsync(file.fileno())
        except Timeout as error:
            raise StorageError(
                "another process is storing detections", where=self._path.name, hint="try again in a moment"
            ) from error
        except OSError as error:
            raise storage_error(error, where=self._path.name) from error


_SIDE = 4 * max(SIDES.values())
"""Longer side in pixels at which photos are searched: a face that is too small to be detected then has less
than 3 pixels in the previews."""


@dataclass(frozen=True, slots=True)
class SuggestedBoxes:
    """Suggested blur boxes of a photo, without what is blurred already; they include margins."""

    id: int
    photo: str
    boxes: tuple[Detection, ...]
    left: int = 0  # Number of further detections, beyond the limit of boxes per photo


class PhotoToSearch(NamedTuple):
    """A photo of a map: its path relative to the map's folder, and its blurred boxes."""

    id: int
    photo: str
    blurred: tuple[BlurBox, ...]


@dataclass(frozen=True, slots=True)
class UnsearchedPhoto:
    """A photo that could not be searched or blurred."""

    id: int
    photo: str
    reason: str


@dataclass(frozen=True, slots=True)
class BlurReport:
    """Suggestions for the photos of a map."""

    suggested: tuple[SuggestedBoxes, ...]  # Of the photos with something to blur, by id
    failed: tuple[UnsearchedPhoto, ...]  # Includes photos with more detections than a photo may have boxes
    searched: int  # Number of photos that were searched, now or earlier


def search_photo(
    file: Path, *, networks: BlurNetworks, kept: DetectionCache, limits: PhotoLimits
) -> list[Detection]:
    """Detect faces and plates in a photo, or return the stored result; the highest scores first.

    Raises:
        PhotoError: The photo is damaged or cannot be read.
        Busy: Too many other photos are being decoded.
    """
    sha256 = _sha256(file)
    known = kept.read().get(sha256)
    return _search(file, sha256, networks=networks, kept=kept, limits=limits) if known is None else known


def photos_of(cfg: Path) -> list[PhotoToSearch]:
    """List the photos of a map, those in its tray included. Raises MapError."""
    the_map = read_map(cfg)
    everything: list[Experience | UnplacedPhoto] = [*the_map.experiences, *the_map.unplaced]
    return sorted(PhotoToSearch(one.id, one.photo, tuple(one.blurred)) for one in everything)


def search_photos(
    cfg: Path,
    photos: Sequence[PhotoToSearch],
    *,
    networks: BlurNetworks,
    limits: PhotoLimits,
    progress: Progress,
    least_score: float = 0.0,
) -> BlurReport:
    """Detect faces and plates in photos of a map.

    The result of each photo is stored at once, so that an interrupted search can be resumed. Raises
    StorageError, Cancelled.

    Args:
        cfg: Map file; it need not exist.
        least_score: Detections with a lower score are not suggested.
    """
    kept = DetectionCache(cfg.parent, networks.key)
    known = kept.read()
    progress.size(len(photos))
    suggested: list[SuggestedBoxes] = []
    failed: list[UnsearchedPhoto] = []
    searched = 0
    for one in photos:
        progress.check()
        was_known = False
        try:
            with show_file_as(one.photo):
                file = photo_path(cfg, one.photo)
                sha256 = _sha256(file)
                was_known = sha256 in known
                if not was_known:
                    known[sha256] = _search(
                        file, sha256, networks=networks, kept=kept, limits=limits, check=progress.check
                    )
        except (PhotoError, MapError, MissingPart) as error:  # a link out of the folder; no format extra
            failed.append(UnsearchedPhoto(one.id, one.photo, error.message))
        else:
            searched += 1
            boxes, left = suggestions(known[sha256], blurred=one.blurred, least_score=least_score)
            if boxes:
                suggested.append(SuggestedBoxes(one.id, one.photo, tuple(boxes), left))
            if left:
                failed.append(UnsearchedPhoto(one.id, one.photo, not_all(left)))
        if was_known:
            progress.skip()
        else:
            progress.advance()
    return BlurReport(tuple(suggested), tuple(failed), searched)


def suggestions(
    found: Iterable[Detection], *, blurred: Sequence[BlurBox], least_score: float = 0.0
) -> tuple[list[Detection], int]:
    """Choose the detections that are not blurred yet, as boxes with margins.

    Returns:
        boxes: The highest scores first, up to the limit per photo.
        left: Number of further ones.
    """
    sure = [one for one in found if one.score >= least_score]
    boxes = boxes_to_blur(sure, blurred=blurred)
    room = max(0, MOST_BOXES - len(blurred))
    return boxes[:room], len(boxes[room:])


def not_all(left: int) -> str:
    """Return the message for a photo with more detections than it may have boxes."""
    return (
        f"a photo may have {MOST_BOXES} boxes, and {left} more faces or plates were found: draw larger boxes"
    )


def _search(
    file: Path,
    sha256: str,
    *,
    networks: BlurNetworks,
    kept: DetectionCache,
    limits: PhotoLimits,
    check: Callable[[], None] = never,
) -> list[Detection]:
    pixels = read_in_turn(file, limits=limits, max_side=_SIDE)
    found = merge_duplicates(
        one for detector in networks.detectors for one in detector.detect(pixels, check=check)
    )
    kept.add(sha256, found)
    return found


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise PhotoError(f"cannot be read: {error.strerror}") from error


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
    """Add suggested blur boxes to the photos of a map outside a library. Raises MapError, StorageError."""
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
