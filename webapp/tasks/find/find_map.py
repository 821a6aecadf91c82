"""Finds out on which of several maps a photo was taken: it is localized on those that look most like it."""

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
from webapp.tasks.localize.map_cache import MapCache, MethodChoice
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto

BUDGET_S = 30.0
"""After so long no further map is begun; those that are left are named."""

MOST_MAPS = 50
"""A photo is localized on so many of the maps that it was compared with, those that are most like it.

Maps that it could not be compared with come after these, all of them.
"""

_NO_TIME = ExpMapError(
    "the search ran out of time before this map", hint="look for the photo on its Localize page"
)
_NO_INDEX = NotReady("it has no index yet", hint="open its Localize page, or run expmap build")


@dataclass(frozen=True, slots=True)
class FoundMap:
    """A map that was searched.

    Attributes
    ----------
    probability : float
        That the photo was taken on it and not on another one.
    answer : dict
        Where on it, as `expmap localize --json` prints it; its probabilities are those of this map alone.
    """

    slug: str
    name: str
    probability: float
    answer: dict[str, Any]


@dataclass(frozen=True, slots=True)
class SkippedMap:
    """A map that was not searched, and why."""

    slug: str
    name: str
    reason: ExpMapError


@dataclass(frozen=True, slots=True)
class MapSearch:
    """The answer to "which map is this?".

    Attributes
    ----------
    maps : tuple of FoundMap
        The most probable first.
    no_map_probability : float
        That it was taken on none of them: on one that was not searched, or on no map at all. What a map says
        of itself is against everything else, so that the maps that nobody asked have their share of this.
    less_alike : int
        Further maps, which were not searched as `MOST_MAPS` others look more like the photo: only maps whose
        photos were compared with it.
    """

    maps: tuple[FoundMap, ...]
    no_map_probability: float
    not_searched: tuple[SkippedMap, ...]
    less_alike: int
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class LibrarySearch:
    """What a search works with.

    Attributes
    ----------
    cache : MapCache
        Localizes.
    ranking : MapRanking
        Says which maps are searched first: time may not be enough for all.
    """

    cache: MapCache
    ranking: MapRanking
    settings: Settings


def find_map(
    search: LibrarySearch,
    records: Sequence[MapRecord],
    *,
    photo: UploadedPhoto,
    top: int = 1,
    progress: Progress | None = None,
) -> MapSearch:
    """Look for a photo on maps, one after the other.

    Parameters
    ----------
    records : sequence of MapRecord
        Those that count.
    top : int
        Maximum number of places on each map.
    progress : Progress, optional
        A step is a map.

    Raises
    ------
    PhotoError
        The photo cannot be used.
    Busy, StorageUnavailable
        No map could be searched: others are being answered, or opened, or their storage is away.
    Cancelled
    """
    begun = time.perf_counter()
    progress = progress or Progress()
    with show_file_as(photo.name, photo.path):
        read_facts(photo.path, limits=search.settings.photo)
        ranked = search.ranking.rank(records, photo.path)
    searched = [*ranked.alike[:MOST_MAPS], *ranked.unknown]
    progress.size(len(searched))
    request = LocalizeRequest((photo,), MethodChoice(), top=top)
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
            found = upload.localize_uploads(
                search.cache, record.id, request=request, settings=search.settings
            )
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
    """Return a search as the API and `expmap find --json` give it.

    Parameters
    ----------
    translate : callable, optional
        Puts messages and hints into the reader's language.
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
    """Sum up what a map says of all its places."""
    return float(sum(place["probability"] for place in form["hypotheses"]) + form["other_probability"])
