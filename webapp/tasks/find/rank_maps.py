"""Ranks the maps of a library by the similarity of their photo vectors to that of a query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.extract import extract
from webapp.core.retrieval import photo_vectors
from webapp.files.photos.photo import read_gray
from webapp.settings import Settings
from webapp.store.backends.photo_search import COMPARED
from webapp.store.library import Library
from webapp.store.maps import photo_vectors as stored
from webapp.store.maps.photo_vectors import StoredBasis
from webapp.store.schema import MapRecord
from webapp.tasks.find.describe_library import features

_READ_AT_ONCE = 100
_BLOCK = 16_384
"""Vectors converted to float32 and compared at once."""


@dataclass(frozen=True, slots=True)
class RankedMaps:
    """Maps in the order in which they are searched for a photo."""

    alike: tuple[MapRecord, ...]  # Those whose photos were compared with the query, the most similar first
    # Those with no vectors yet, whose similarity is unknown, in the given order.
    unknown: tuple[MapRecord, ...]


class MapRanking:
    """Compares a photo with those of a library, in the database if it has a vector search.

    Otherwise, and for maps that the search does not have yet, the vectors are held in memory (256 bytes per
    photo) and compared exhaustively, which takes 0.25 s for a million; maps that have changed since the last
    query are read again.
    """

    def __init__(self, library: Library, settings: Settings) -> None:
        self._library = library
        self._settings = settings
        self._lock = Lock()
        self._basis: StoredBasis | None = None
        self._maps: dict[int, tuple[str, NDArray[np.float16]]] = {}

    def rank(self, records: Sequence[MapRecord], photo: Path) -> RankedMaps:
        """Sort maps by similarity, the most similar first; those that cannot be compared yet are separate.

        Raises:
            PhotoError: The photo cannot be used.
        """
        with self._lock:
            self._refresh()
            basis, maps = self._basis, {r.id: self._maps[r.id][1] for r in records if r.id in self._maps}
        if basis is None or len(records) < 2:
            return RankedMaps((), tuple(records))
        query = photo_vectors.vector(basis.basis, self._descriptors(photo))
        score = self._in_database(query, records, basis_id=basis.id)
        score |= {id: likeness(vectors, query) for id, vectors in maps.items()}
        alike = sorted((r for r in records if r.id in score), key=lambda record: -score[record.id])
        return RankedMaps(tuple(alike), tuple(r for r in records if r.id not in score))

    def _in_database(
        self, query: NDArray[np.float32], records: Sequence[MapRecord], *, basis_id: int
    ) -> dict[int, float]:
        database = self._library.database
        if database.photo_search is None:
            return {}
        with database.translated_errors():
            return database.photo_search.likeness(query, basis_id=basis_id, map_ids=[r.id for r in records])

    def _refresh(self) -> None:
        """Read the basis and the vectors that have changed."""
        with self._library.database.read() as session:
            ready = stored.ready_basis(session, known=self._basis)
            if ready is None or self._basis is None or ready.id != self._basis.id:
                self._basis, self._maps = ready, {}
            if ready is None:
                return
            wanted = self._not_in_database(ready.id)
            versions = {} if wanted == set() else stored.versions(session, basis_id=ready.id)
            versions = {id: version for id, version in versions.items() if wanted is None or id in wanted}
            old = {id for id, (version, _) in self._maps.items() if versions.get(id) != version}
            self._maps = {id: found for id, found in self._maps.items() if id not in old}
            missing = [id for id in versions if id not in self._maps]
            for start in range(0, len(missing), _READ_AT_ONCE):
                some = missing[start : start + _READ_AT_ONCE]
                self._maps |= stored.matrices(session, some, basis_id=ready.id)

    def _not_in_database(self, basis_id: int) -> set[int] | None:
        """Return the ids of the maps that are out of date in the vector search; None for all maps."""
        database = self._library.database
        if database.photo_search is None:
            return None
        with database.translated_errors():
            stale = database.photo_search.stale()
        return None if stale is None else {map_id for map_id, of in stale if of == basis_id}

    def _descriptors(self, photo: Path) -> NDArray[np.uint8]:
        asked = self._settings.extract
        gray = read_gray(photo, limits=self._settings.photo, max_side=asked.max_side_px)
        found = extract(
            gray.pixels, features(), keypoints=asked.keypoints, scale=gray.scale, photo_size=gray.full_size
        )
        return found.descriptors


def likeness(vectors: NDArray[np.float16], query: NDArray[np.float32]) -> float:
    """Return the mean cosine similarity of the `COMPARED` most similar photos."""
    blocks = (vectors[start : start + _BLOCK] for start in range(0, len(vectors), _BLOCK))
    cosines = np.concatenate([np.zeros(0, np.float32), *(b.astype(np.float32) @ query for b in blocks)])
    if len(cosines) > COMPARED:
        cosines = np.partition(cosines, -COMPARED)[-COMPARED:]
    return float(cosines.mean()) if len(cosines) else -1.0
