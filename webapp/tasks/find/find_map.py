"""Finds out on which of several maps a photo was taken, by localizing it on the most similar ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from webapp.core.hypotheses.across_maps import probabilities_over_maps
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
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.schema import MapRecord
from webapp.tasks.find.rank_maps import MapRanking
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto

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
    """A map that was searched."""

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
    """The result of a search."""

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
    """What a search needs."""

    cache: MapCache  # Localizes the photo
    ranking: MapRanking  # Determines which maps are searched first: there may not be time for all
    settings: Settings


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
        records: The maps to search.
        top: Maximum number of places on each map.
        progress: One step per map.

    Raises:
        PhotoError: The photo cannot be used.
        Busy, StorageUnavailable: No map could be searched: the process is busy, maps are being opened, or
            their storage is unavailable.
        Cancelled
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
        except NotReady:
            skipped.append(SkippedMap(record.slug, record.name, _NO_INDEX))
        except (BeingOpened, StorageUnavailable) as error:
            away = away or error
            skipped.append(SkippedMap(record.slug, record.name, error))
        except Busy as error:
            if not answers:
                raise
            skipped.append(SkippedMap(record.slug, record.name, error))
        except (MapError, NotFound, IndexDamaged) as error:
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


def search_json(search: MapSearch, *, query: str, translate: Callable[[str], str] = str) -> dict[str, Any]:
    """Convert a search to JSON values, for the API and `expmap find --json`.

    Args:
        translate: Translates messages and hints.
    """
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
