"""Finds out how a map's photos were held, from what they see in common; keeps it beside the index."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.reconstruction.orientation import orient
from webapp.core.reconstruction.pairs import Pairs, joined, pairs_of
from webapp.core.reconstruction.types import Orientations
from webapp.files import orientationfile
from webapp.files.orientationfile import StoredOrientations, StoredPairs
from webapp.progress import Progress
from webapp.tasks.open_map import OpenMap
from webapp.threads import in_threads

_AT_ONCE = 32
"""Photos between two looks at whether to stop."""

_SAVED_EVERY_S = 20.0
_MOVED = 0.5
"""A photo that has been moved farther since, in place radii, has no known orientation."""


def run(opened: OpenMap, *, map_fov_deg: float | None, progress: Progress) -> OpenMap:
    """Bring the orientations of a map's photos up to date and attach them to it.

    What was found out of single photos is kept: photos that are new are compared with the others, and one
    that is moved changes nothing but the last, quick step. Killed, it goes on where it was.

    Parameters
    ----------
    opened : OpenMap
        A method that verifies.
    map_fov_deg : float or None
        As given for photos that do not tell theirs.
    progress : Progress
        One step a photo that is new.

    Raises
    ------
    StorageError, Cancelled
    """
    key = f"{opened.map_hash} {map_fov_deg}"
    stored = newest(opened)
    if stored is not None and stored.key == key:
        progress.size(0)
    else:
        pairs = _pairs(opened, map_fov_deg=map_fov_deg, progress=progress)
        progress.note("working out how the photos were held")
        indexed = opened.indexed
        found = orient(pairs, indexed.position, place_radius_px=indexed.place_radius_px)
        stored = StoredOrientations(found, opened.contents, indexed.position, key)
        orientationfile.write(paths(opened)[-1], stored)
    return attach(opened, stored)


def paths(opened: OpenMap) -> tuple[Path, Path]:
    """Name the files in which a map's orientations may be; the last one is written."""
    return opened.beside(f"orientations-{opened.choice.matcher}.arrays")


def newest(opened: OpenMap) -> StoredOrientations | None:
    """Read the stored orientations, also where the map has changed since; None where there are none."""
    known = (orientationfile.read(path) for path in reversed(paths(opened)))
    return next((k for k in known if k is not None), None)


def attach(opened: OpenMap, stored: StoredOrientations | None) -> OpenMap:
    """Give an open map the orientations of those of its photos that are where they were."""
    if stored is None:
        return opened
    indexed = opened.indexed
    number = {content: i for i, content in enumerate(stored.contents) if content}
    row = np.array([number.get(content, -1) for content in opened.contents], np.int64)
    moved = np.hypot(*(indexed.position - stored.position[row]).T)
    known = (row >= 0) & (moved <= _MOVED * indexed.place_radius_px)
    there = stored.orientations
    found = Orientations(
        rotation=there.rotation[row],
        height=there.height[row],
        trust=np.where(known, there.trust[row], 0.0),
    )
    return replace(opened, indexed=replace(indexed, orientations=found))


def _pairs(opened: OpenMap, *, map_fov_deg: float | None, progress: Progress) -> Pairs:
    """Take the pairs that are stored, look for those of new photos, and store them."""
    path = opened.writable / f"pairs-{opened.choice.matcher}.arrays"
    key = f"{opened.choice.matcher} {map_fov_deg}"
    known = orientationfile.read_pairs(path)
    indexed, contents = opened.indexed, opened.contents
    number = {content: i for i, content in reversed([*enumerate(contents)]) if content}
    parts, done = _still_there(known if known is not None and known.key == key else None, number)
    todo = [i for content, i in number.items() if content not in done]
    progress.note("comparing the map's photos with each other")
    progress.size(len(todo))
    saved = time.monotonic()
    for first in range(0, len(todo), _AT_ONCE):
        progress.check()
        chunk = todo[first : first + _AT_ONCE]
        parts += in_threads(lambda i: pairs_of(indexed, i), chunk)
        done |= {contents[i] for i in chunk}
        progress.advance(len(chunk))
        last = first + _AT_ONCE >= len(todo)
        if last or time.monotonic() > saved + _SAVED_EVERY_S:
            parts = [joined(parts)]
            _store(path, parts[0], contents=contents, done=done, key=key)
            saved = time.monotonic()
    return joined(parts)


def _still_there(known: StoredPairs | None, number: dict[str, int]) -> tuple[list[Pairs], set[str]]:
    """Give the stored pairs whose photos are both still in the map, and the photos that are done."""
    if known is None:
        return [], set()
    now: NDArray[np.int64] = np.array([number.get(c, -1) for c in known.contents], np.int64)
    first, second = now[known.pairs.first], now[known.pairs.second]
    which = np.flatnonzero((first >= 0) & (second >= 0))
    return [known.pairs.taken(which, first=first[which], second=second[which])], set(
        known.contents[: known.done]
    )


def _store(path: Path, pairs: Pairs, *, contents: list[str], done: set[str], key: str) -> None:
    """Write pairs by content: the photos that are done come first."""
    ordered = sorted({c for c in contents if c}, key=lambda c: c not in done)
    place = {c: i for i, c in enumerate(ordered)}
    number = np.array([place.get(c, -1) for c in contents], np.int64)
    every = np.arange(len(pairs))
    stored = pairs.taken(every, first=number[pairs.first], second=number[pairs.second])
    count = sum(c in done for c in ordered)
    orientationfile.write_pairs(path, StoredPairs(stored, ordered, count, key))
