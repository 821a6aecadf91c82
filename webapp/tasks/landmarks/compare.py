"""Matches pairs of photos for a reconstruction, locally or with Dask; each finished pair is stored."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.matching import Views, choose_pairs, match_mutually
from webapp.files.landmarks.match_database import MatchDatabase, StoredPhoto, stored_photo, two_view_geometry
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.progress import Progress
from webapp.tasks.computing.in_order import ExecutionTarget, in_order

_HELD = 64
"""Photos that a worker keeps in memory: those of neighbouring pairs."""


class ComparedPhotos:
    """The photos to compare; a Dask worker reads their features from files.

    Args:
        folder: Folder of the features.
        contents: SHA-256 of the photos.
        photos: The photos, if they are in memory.
    """

    def __init__(
        self,
        folder: Path,
        contents: Sequence[str],
        *,
        cameras: Sequence[tuple[int, Any]],
        photos: Sequence[StoredPhoto] | None = None,
    ) -> None:
        self._state = (folder, tuple(contents), tuple(cameras))
        self.photo = lru_cache(_HELD)(self._read) if photos is None else photos.__getitem__

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle without the photos in memory."""
        return _on_worker, self._state

    def _read(self, number: int) -> StoredPhoto:
        folder, contents, cameras = self._state
        features = read_segment(IndexFolder(folder).spool_path(contents[number]), mapped=False)
        return stored_photo(*cameras[number], features=features.entry(0).features)


def _on_worker(folder: Path, contents: Sequence[str], cameras: Sequence[tuple[int, Any]]) -> ComparedPhotos:
    return ComparedPhotos(folder, contents, cameras=cameras)


def compare_photos(
    database: MatchDatabase,
    photos: Sequence[tuple[str, StoredPhoto]],
    *,
    at: NDArray[np.complex128],
    views: Views,
    place: ExecutionTarget,
    progress: Progress,
) -> None:
    """Match the pairs that have not been matched yet.

    Raises Cancelled, ProcessLost, ClusterUnavailable, UsageError, MissingPart.

    Args:
        photos: Photos with their content hashes.
        at: (p,) complex128. Positions on the map; NaN where there is none.
        place: Its folder is that of the features.
    """
    progress.note("finding overlapping photos")
    stored = [photo for _, photo in photos]
    pairs = [
        (one, other)
        for one, other in choose_pairs([p.descriptors for p in stored], at=at, views=views).tolist()
        if not database.is_compared(stored[one], stored[other])
    ]
    progress.note("matching the photos")
    progress.size(len(pairs))
    shared = ComparedPhotos(
        place.folder.absolute(),
        [content for content, _ in photos],
        cameras=[(photo.id, photo.camera) for photo in stored],
        photos=stored,
    )
    found = in_order(_compare, pairs, shared=shared, at=place, progress=progress)
    for (one, other), geometry in zip(pairs, found, strict=True):
        database.keep(stored[one], stored[other], geometry=geometry)
        progress.advance()


def _compare(photos: ComparedPhotos, pair: tuple[int, int]) -> Any:
    one, other = map(photos.photo, pair)
    return two_view_geometry(one, other, matches=match_mutually(one.descriptors, other.descriptors))
