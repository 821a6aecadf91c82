"""Finds out on which of several maps a photo was taken.

The maps are ranked by the similarity of their photo vectors to that of the photo, which is then localized on
the most similar ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.extract import extract
from webapp.core.hypotheses.across_maps import probabilities_over_maps
from webapp.core.retrieval import global_descriptors
from webapp.errors import (
    BeingOpened,
    Busy,
    ExpMapError,
    IndexDamaged,
    MapError,
    NotFound,
    NotReady,
    StorageUnavailable,
)
from webapp.files.part_file import show_file_as
from webapp.files.photos.photo import read_facts, read_gray
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.backends.photo_search import COMPARED
from webapp.store.library import Library
from webapp.store.maps import photo_vectors as stored
from webapp.store.maps.photo_vectors import StoredBasis
from webapp.store.schema import MapRecord
from webapp.tasks.find.describe_library import features
from webapp.tasks.localize import readiness, upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto

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
        """Sort maps by similarity, the most similar first; those that cannot be compared yet are separate."""
        with self._lock:
            self._refresh()
            basis, maps = self._basis, {r.id: self._maps[r.id][1] for r in records if r.id in self._maps}
        if basis is None or len(records) < 2:
            return RankedMaps((), tuple(records))
        query = global_descriptors.photo_vector(basis.basis, self._descriptors(photo))
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


BUDGET_S = 30.0
"""No further map is begun after this time; the remaining ones are reported."""

MOST_MAPS = 50
"""A photo is localized on at most this many of the maps that it was compared with, the most similar ones.

All maps that it could not be compared with come after these.
"""

_NO_TIME = ExpMapError(
    "the search ran out of time before this map", hint="look for the photo on its Localize page"
)
_NO_INDEX = NotReady("it has no index yet", hint="open its Localize page, or run expmap build")


@dataclass(frozen=True, slots=True)
class FoundMap:
    slug: str
    name: str
    probability: float  # That the photo was taken on this map and not on another one
    answer: dict[str, Any]  # As `expmap localize --json` prints it; its probabilities consider this map alone


@dataclass(frozen=True, slots=True)
class SkippedMap:
    """A map that was not searched, and why."""

    slug: str
    name: str
    reason: ExpMapError


@dataclass(frozen=True, slots=True)
class MapSearch:
    maps: tuple[FoundMap, ...]  # The most probable first
    # That it was taken on none of them: on one that was not searched, or on no map at all. The probability of
    # a map is against everything else, so that maps that were not searched are included here.
    no_map_probability: float
    not_searched: tuple[SkippedMap, ...]
    # Number of maps that were compared with the photo but not searched, as `MOST_MAPS` others are more
    # similar.
    less_alike: int
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class LibrarySearch:
    cache: MapCache  # Localizes the photo
    ranking: MapRanking  # Determines which maps are searched first: there may not be time for all
    settings: Settings
    builds: bool = False  # Have the indexes that are missing built, before other long work


def find_map(
    search: LibrarySearch,
    records: Sequence[MapRecord],
    *,
    photo: UploadedPhoto,
    top: int = 1,
    progress: Progress | None = None,
) -> MapSearch:
    """Localize a photo on maps, one after the other.

    Args:
        top: Maximum number of places on each map.

    Raises:
        PhotoError: The photo cannot be used.
        Busy, StorageUnavailable: No map could be searched: the process is busy, maps are being opened, or
            their storage is unavailable.
    """
    begun = time.perf_counter()
    progress = progress or Progress()
    with show_file_as(photo.name, photo.path):
        read_facts(photo.path, limits=search.settings.photo)
        ranked = search.ranking.rank(records, photo.path)
    searched = [*ranked.alike[:MOST_MAPS], *ranked.unknown]
    progress.size(len(searched))
    request = LocalizeRequest((photo,), OpenOptions(), top=top)
    answers: list[tuple[MapRecord, dict[str, Any]]] = []
    skipped: list[SkippedMap] = []
    away: ExpMapError | None = None
    for record in searched:
        progress.check()
        progress.note(record.name)
        if time.perf_counter() - begun > BUDGET_S:
            skipped.append(SkippedMap(record.slug, record.name, _NO_TIME))
            progress.advance(1)
            continue
        try:
            found = upload.localize_uploads(search.cache, record.id, request=request)
            answers.append((record, found.form))
        except (NotReady, IndexDamaged) as error:
            skipped.append(SkippedMap(record.slug, record.name, _without_index(search, record, error)))
        except (BeingOpened, StorageUnavailable) as error:
            away = away or error
            skipped.append(SkippedMap(record.slug, record.name, error))
        except Busy as error:
            if not answers:
                raise
            skipped.append(SkippedMap(record.slug, record.name, error))
        except (MapError, NotFound) as error:
            skipped.append(SkippedMap(record.slug, record.name, error))
        progress.advance(1)
    if away is not None and not answers:
        raise away
    each, none = probabilities_over_maps([_on_map(form) for _, form in answers])
    found_maps = [FoundMap(r.slug, r.name, p, form) for (r, form), p in zip(answers, each, strict=True)]
    found_maps.sort(key=lambda one: -one.probability)
    return MapSearch(
        maps=tuple(found_maps),
        no_map_probability=none,
        not_searched=tuple(skipped),
        less_alike=len(ranked.alike[MOST_MAPS:]),
        seconds=time.perf_counter() - begun,
    )


def _without_index(search: LibrarySearch, record: MapRecord, error: ExpMapError) -> ExpMapError:
    """Have the index of a map built, if that is wanted; return what to say about the map."""
    if search.builds and readiness.build_first(search.cache.library, record, settings=search.settings):
        return readiness.being_built(record)
    return error if isinstance(error, IndexDamaged) else _NO_INDEX


def search_json(search: MapSearch, *, query: str, translate: Callable[[str], str] = str) -> dict[str, Any]:
    """Convert a search to JSON values, for the API and `expmap find --json`."""
    return {
        "query": query,
        "maps": [
            {"slug": one.slug, "name": one.name, "probability": one.probability, "answer": one.answer}
            for one in search.maps
        ],
        "no_map_probability": search.no_map_probability,
        "not_searched": [
            {
                "slug": one.slug,
                "name": one.name,
                "reason": translate(one.reason.message),
                "hint": None if one.reason.hint is None else translate(one.reason.hint),
            }
            for one in search.not_searched
        ],
        "less_alike": search.less_alike,
        "seconds": search.seconds,
    }


def _on_map(form: dict[str, Any]) -> float:
    """Return the probability that the photo was taken on a map: the sum over its places."""
    return float(sum(place["probability"] for place in form["hypotheses"]) + form["other_probability"])
