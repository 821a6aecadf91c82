"""Landmarks of a part of a map: the photos around a place are reconstructed when a query asks there."""

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
"""The photos that were tried, written once all else of the part is there."""

_FORMAT = 2

MOST_PARTS = 50
"""Of a map; the oldest go first."""

_MOST = 0.6
"""Share of the photos of a place with which a part serves it."""


class _Deadline(Progress):
    """A progress that stops the work in time; what it has finished is kept."""

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
    """Find the folder of a reconstruction that has the first of some photos, and most of them.

    Of several it is the one with the most; None where there is none. One whose photos could not be joined
    says nothing of other photos.
    """
    names = {photo.photo for photo in photos}
    serving = {folder: len(names & has) for folder, has in _joined_parts(cfg) if photos[0].photo in has}
    if not serving:
        return None
    folder = max(serving, key=lambda folder: (serving[folder], folder.name))
    return folder if serving[folder] >= _MOST * len(names) else None


def part_of(cfg: Path, photos: Sequence[Experience]) -> Path | None:
    """Find the folder in which exactly these photos were tried, joined or not; None where they were not."""
    folder = _folder(cfg, photos)
    return None if _read(folder / _FILE) is None else folder


def reconstruct_part(
    cfg: Path, the_map: Map, *, photos: Sequence[Experience], settings: Settings, progress: Progress
) -> Path:
    """Reconstruct some photos of a map, and keep what comes of it.

    Whoever comes while another process is at it waits, and takes what that has made.

    Returns
    -------
    Path
        Its folder, in which there are no points where the photos cannot be joined.

    Raises
    ------
    StorageError
        It takes more seconds than it may; what is finished is kept, and the next time it goes on there.
    MissingPart
        The extra `sfm` is not installed.
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
    """Read which photos the parts of a map have, of those with points."""
    for file in (landmarks_folder(cfg) / SURROUNDINGS).glob(f"*/{_FILE}"):
        form = _read(file)
        if form is not None and form["joined"]:
            yield file.parent, frozenset(form["photos"])


def _read(file: Path) -> dict[str, Any] | None:
    """Read what was tried; None where nothing was, or it has to be tried again."""
    try:
        form: dict[str, Any] = json.loads(file.read_bytes())
        return form if form["format"] == _FORMAT else None
    except (OSError, ValueError, KeyError):
        return None


def _remove_oldest(parts: Path) -> None:
    """Keep the newest parts, also of those that are not finished."""
    for folder in sorted(parts.glob("*"), key=_changed_at)[:-MOST_PARTS]:
        (folder / _FILE).unlink(missing_ok=True)  # first: what is left by a killed process serves nobody
        shutil.rmtree(folder, ignore_errors=True)


def _changed_at(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:  # another process has removed it just now
        return 0
