"""Method `landmarks` on a map without landmarks: those around a place are made when needed."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from webapp.core.features.types import Features
from webapp.core.hypotheses.calibration import DEFAULT
from webapp.core.hypotheses.model import Answer, FieldOfView, Hypothesis
from webapp.core.localize.landmarks import find_by_landmarks
from webapp.core.localize.verified import with_probabilities
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import experiences_of
from webapp.errors import Cancelled, IndexDamaged, ProcessLost, StorageError
from webapp.files.atomic import remove_unfinished, storage_error, write_text
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.reconstruct import SURROUNDINGS, reconstruct
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.geometry import align_landmarks
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.localize.open_map import OpenMap

NOT_YET = "the landmarks around this place are not reconstructed yet: ask again in a minute"
"""Note of an answer that has no pose yet."""


_ENOUGH = 100
"""Matches of two photos above which further ones add no information."""

_REACH = 4
"""Photos are chosen among the nearest ones, this many times the wanted number."""


@dataclass(frozen=True, slots=True)
class LandmarksAround:
    """Solves the camera of a query from landmarks around its best place."""

    settings: Settings
    progress: Progress  # Progress of a reconstruction
    build: bool  # Whether to reconstruct the surroundings at once, if that has not been done

    def refine(
        self, answer: Answer, opened: OpenMap, *, query: Features, fov: FieldOfView, hide: Collection[int]
    ) -> Answer:
        """Refine the first hypothesis to a pose from landmarks around it, within the map's place radius.

        Its probability stays: it is that of the place. Without a pose, the answer has a note instead. Raises
        Cancelled.

        Args:
            answer: With ids of experiences, and headings clockwise from image-up.
        """
        if answer.abstained:
            return replace(answer, note="no place is likely enough to look for landmarks around it")
        first, *others = answer.hypotheses
        try:
            folder = self._folder(opened, first)
        except (StorageError, ProcessLost, IndexDamaged) as error:
            return replace(answer, note=error.message)
        if folder is None:
            return replace(answer, note=NOT_YET)
        found = _solve(opened, folder, query=query, near=first, fov=fov, hide=hide)
        if found is None:
            return replace(answer, note="too few landmarks around this place agree with the photo")
        solved = replace(
            first,
            kind="position",
            position=found.position,
            radius_px=found.radius_px,
            heading_deg=found.heading_deg,
            camera=found.camera,
        )
        return replace(answer, hypotheses=(solved, *others))

    def _folder(self, opened: OpenMap, place: Hypothesis) -> Path | None:
        there = part_around(opened.cfg, _experiences(opened, place.experiences))
        if there is not None:
            return there
        ids = photos_around(opened, place.experiences, count=self.settings.landmarks.around_photos)
        photos = _experiences(opened, ids)
        tried = part_of(opened.cfg, photos)
        if tried is not None or not self.build:
            return tried
        return reconstruct_part(
            opened.cfg,
            opened.map,
            photos=photos,
            settings=self.settings,
            progress=self.progress,
        )


def photos_around(opened: OpenMap, seeds: Sequence[int], *, count: int) -> list[int]:
    """Choose photos that are covisible with the seeds; next is always the one that shares most matches.

    If none shares any with those chosen, the nearest is next. Distant ones are excluded: facades look alike.
    Raises StorageError.

    Args:
        seeds: Ids of experiences, the best first; they are all chosen.
        count: Maximum number of photos, seeds included; a panorama counts as its views.
    """
    pairs = orient_map.stored_pairs(opened)
    ids = np.array([e.id for e in opened.map.experiences])
    position = np.array([e.position for e in opened.map.experiences])
    row = np.searchsorted(ids, experiences_of(opened.indexed.ids), sorter=(order := np.argsort(ids)))
    first, second = (order[row[of]] for of in (pairs.first, pairs.second))
    shared = np.minimum(np.diff(pairs.start), _ENOUGH)
    views = np.bincount(order[row], minlength=len(ids))
    chosen = [int(np.flatnonzero(ids == seed)[0]) for seed in seeds]
    distance = np.hypot(*(position - position[chosen[0]]).T)
    reach = np.sort(np.repeat(distance, views))[: _REACH * count].max()
    gain = np.where(distance <= reach, -distance / (1.0 + reach), -np.inf)
    for one, other in ((first, second), (second, first)):
        gain += np.bincount(other, shared * np.isin(one, chosen), minlength=len(ids))
    gain[chosen] = -np.inf
    while np.isfinite(gain.max()):
        best = int(gain.argmax())
        if views[[*chosen, best]].sum() > count:
            break
        chosen.append(best)
        for one, other in ((first, second), (second, first)):
            gain += np.bincount(other, shared * (one == best), minlength=len(ids))
        gain[best] = -np.inf
    return [int(id) for id in ids[chosen]]


def _experiences(opened: OpenMap, ids: Sequence[int]) -> list[Experience]:
    known = {e.id: e for e in opened.map.experiences}
    return [known[id] for id in ids]


def _solve(
    opened: OpenMap,
    folder: Path,
    *,
    query: Features,
    near: Hypothesis,
    fov: FieldOfView,
    hide: Collection[int],
) -> Hypothesis | None:
    """Solve the camera from the landmarks in a folder; None if that fails, or it is not near the place."""
    aligned = align_landmarks(opened, folder)
    if aligned is None:
        return None
    indexed = opened.indexed
    search = find_by_landmarks(indexed, query, fov=fov, aligned=aligned, hide=hide)
    solved = with_probabilities(indexed, search, calibration=DEFAULT, top=len(search.places))
    close = (
        h
        for h in solved.hypotheses
        if h.floor == near.floor and math.dist(h.position, near.position) <= indexed.place_radius_px
    )
    return next(close, None)


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
