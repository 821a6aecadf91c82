"""Landmarks of a part of a map: the photos around a place are reconstructed when a query needs them."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from webapp.core.mapmodel.model import Experience, Map
from webapp.errors import Cancelled, StorageError
from webapp.files.atomic import remove_unfinished, storage_error, write_text
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.reconstruct import SURROUNDINGS, reconstruct
from webapp.tasks.localize.index_location import landmarks_folder

_FILE = "photos.json"
"""List of the photos of a part; written last, once the part is complete."""

_FORMAT = 2

MOST_PARTS = 50
"""Maximum number of parts of a map; the oldest are deleted."""

_MOST = 0.6
"""Minimum share of the photos around a place that a part must have to be used for it."""


class _Deadline(Progress):
    """A progress that cancels the work at a deadline."""

    def __init__(self, inner: Progress, until_s: float) -> None:
        self._inner = inner
        self._until_s = until_s

    def note(self, text: str) -> None:
        self._inner.note(text)

    def size(self, total: int) -> None:
        self._inner.size(total)

    def advance(self, steps: int = 1) -> None:
        self._inner.advance(steps)

    def cancelled(self) -> bool:
        return self._inner.cancelled() or time.monotonic() >= self._until_s


def part_around(cfg: Path, photos: Sequence[Experience]) -> Path | None:
    """Find the folder of a part that has the first of some photos, and most of them; None if there is none.

    Of several, the one with the most is returned. Parts whose photos could not be joined are ignored.
    """
    names = {photo.photo for photo in photos}
    serving = {folder: len(names & has) for folder, has in _joined_parts(cfg) if photos[0].photo in has}
    if not serving:
        return None
    folder = max(serving, key=lambda folder: (serving[folder], folder.name))
    return folder if serving[folder] >= _MOST * len(names) else None


def part_of(cfg: Path, photos: Sequence[Experience]) -> Path | None:
    """Find the folder of the part of exactly these photos, joined or not; None if it was not tried."""
    folder = _folder(cfg, photos)
    return None if _read(folder / _FILE) is None else folder


def reconstruct_part(
    cfg: Path, the_map: Map, *, photos: Sequence[Experience], settings: Settings, progress: Progress
) -> Path:
    """Reconstruct some photos of a map, and store the result.

    If another process is doing so, wait for it and use its result.

    Returns:
        Folder of the part; it has no points if the photos cannot be joined.

    Raises:
        StorageError: The time limit was exceeded; finished steps are kept, and the next call resumes there.
        MissingPart: The extra `sfm` is not installed.
        ProcessLost, Cancelled
    """
    budget_s = settings.landmarks.around_s
    until_s = time.monotonic() + budget_s
    folder = _folder(cfg, photos)
    some = replace(the_map, experiences=tuple(photos), unplaced=())
    within = _Deadline(progress, until_s)
    with writer_lock(folder, wait_s=budget_s):
        remove_unfinished(folder / _FILE)
        try:
            found = reconstruct(cfg, some, settings=settings, progress=within, part=folder, wait_s=budget_s)
            within.check()
            adjust_submodels(found, some, progress=within, wait_s=max(until_s - time.monotonic(), 0.0))
        except Cancelled:
            progress.check()
            raise StorageError(
                f"the landmarks around this place take longer than {budget_s:g} s",
                hint="ask again: it goes on where it stopped",
            ) from None
        except OSError as error:
            raise storage_error(error, where=str(folder)) from error
        names = [photo.photo for photo in photos]
        form = {"format": _FORMAT, "photos": names, "joined": bool(found.submodels)}
        write_text(folder / _FILE, json.dumps(form))
    _remove_oldest(folder.parent)
    return folder


def _folder(cfg: Path, photos: Sequence[Experience]) -> Path:
    names = sorted(photo.photo for photo in photos)
    name = hashlib.sha256(json.dumps(names).encode()).hexdigest()[:16]
    return landmarks_folder(cfg) / SURROUNDINGS / name


def _joined_parts(cfg: Path) -> Iterator[tuple[Path, frozenset[str]]]:
    """Yield folder and photos of the parts that have points."""
    for file in (landmarks_folder(cfg) / SURROUNDINGS).glob(f"*/{_FILE}"):
        form = _read(file)
        if form is not None and form["joined"]:
            yield file.parent, frozenset(form["photos"])


def _read(file: Path) -> dict[str, Any] | None:
    """Read the list of photos of a part; None if it is missing, damaged or of another format."""
    try:
        form: dict[str, Any] = json.loads(file.read_bytes())
        return form if form["format"] == _FORMAT else None
    except (OSError, ValueError, KeyError):
        return None


def _remove_oldest(parts: Path) -> None:
    """Delete the oldest parts, unfinished ones included."""
    for folder in sorted(parts.glob("*"), key=_changed_at)[:-MOST_PARTS]:
        (folder / _FILE).unlink(missing_ok=True)  # first: a half-deleted part must not be used
        shutil.rmtree(folder, ignore_errors=True)


def _changed_at(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:  # another process has removed it
        return 0
