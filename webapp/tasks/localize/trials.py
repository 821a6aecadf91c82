"""Trials: photos of a map are used as queries, each hidden from the map alone or with others."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import EVIDENCE, Calibration
from webapp.core.hypotheses.places import spacing_px
from webapp.core.hypotheses.priors import PathPrior, apply_path_prior
from webapp.core.localize.places import LocatedPlace, PlaceCandidate, locate
from webapp.core.localize.verified import PlaceSearch, find_places
from webapp.core.mapmodel.panorama import experiences_of
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.core.retrieval.indexed import IndexedMap, candidates
from webapp.core.retrieval.retrieve import filter_by_rotation, weighted_votes
from webapp.files.localize.adopted import AdoptedPhoto
from webapp.files.localize.calibration import TrialRecord
from webapp.progress import Progress

FindPlaces = Callable[..., PlaceSearch]

Hidden = Literal["photo", "place", "surroundings", "nothing", "later"]
"""What is hidden from the map in a trial; nothing for a real query with known position, and what was added
after it for one that is now on the map."""

REAL: frozenset[Hidden] = frozenset({"nothing", "later"})

MOST_PHOTOS = 200

_HIDDEN: tuple[Hidden, ...] = ("photo", "surroundings", "photo", "place")
"""What is hidden in successive trials: the photo alone, like a repeated visit; all photos of its place; or
all of its surroundings, like a query from off the map."""

_TRIALS_AS_QUERIES = 10
"""Number of real queries that have as much weight as all trials with a photo that is on the map."""

_OFF_MAP_WEIGHT = 0.2
"""Weight of an off-map trial relative to an on-map one: with the mix of `_HIDDEN`, a prior of 15/16 that a
query is on the map. With less, photos of look-alike streets are placed; with more, maps of repetitive
appearance (a corridor, a campus) reject their own photos."""

_SAME_PLACE = 1.05
"""Photos within this distance, in photo spacings of the map, are hidden with the trial's photo: the remaining
ones are about as far away as map photos are from a new query."""

_ELSEWHERE, _MOST_HIDDEN = 10.0, 0.6
"""For an off-map trial, photos within this distance in place radii are hidden (visibility along a path is
long), but at most about this share of the map, the nearest photos."""

_OTHER_DAY_EVERY, _LEFT_ON_OTHER_DAY = 2, 10
"""Every second trial with a hidden place keeps only one in ten of its keypoints, as if few were detected
again on another day."""

_ALIKE = 0.5
"""Photos of an area with more than this share of the most votes count as the same capture."""

STRONG_INLIERS = 40
"""Number of inliers from which on a photo certainly shows the same scene as the query."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A photo of the map that was used as a query."""

    evidence: NDArray[np.float64]  # (h, EVIDENCE) float64
    places: list[PlaceCandidate]  # Without their photos if read from a record
    truth: tuple[float, float]  # (x, y)
    hidden: Hidden
    strong: bool  # The best-matching photo certainly shows the same scene
    seconds: float  # CPU time of the search in this thread: a busy machine does not lengthen it
    floor: int = BASE_FLOOR  # Id of its floor
    share: float = 1.0  # Factor on its weight; see `with_queries`

    @property
    def weight(self) -> float:
        """Weight in a fit."""
        return _OFF_MAP_WEIGHT if self.hidden == "surroundings" else self.share

    @property
    def _has_floors(self) -> bool:
        return any(floor != BASE_FLOOR for floor in (self.floor, *(p.floor for p in self.places)))

    def error_px(self, at: MapPixel, floor: int) -> float:
        """Compute the distance of a place from the truth; infinite on another floor."""
        return math.dist(at, self.truth) if floor == self.floor else math.inf

    def to_record(self) -> dict[str, Any]:
        """Convert it to plain values."""
        places = [[p.kind, *p.position, p.sigma_px, *p.anchor, p.area] for p in self.places]
        return {
            "evidence": self.evidence.tolist(),
            "places": places,
            "truth": [*self.truth],
            "hidden": self.hidden,
            "strong": self.strong,
            "seconds": round(self.seconds, 4),
            **({"floors": [self.floor, *(p.floor for p in self.places)]} if self._has_floors else {}),
        }

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Trial:
        """Build it from plain values."""
        floor, *floors = record.get("floors") or [BASE_FLOOR] * (1 + len(record["places"]))
        places = [
            PlaceCandidate(kind, MapPixel(x, y), None, sigma, [], 0.0, MapPixel(ax, ay), area, floor=on)
            for (kind, x, y, sigma, ax, ay, area), on in zip(record["places"], floors, strict=True)
        ]
        evidence = np.array(record["evidence"], np.float64).reshape(-1, EVIDENCE)
        x, y = record["truth"]
        strong, seconds = record["strong"], record["seconds"]
        return cls(evidence, places, (x, y), record["hidden"], strong, seconds, floor)

    def located(self, indexed: IndexedMap, calibration: Calibration) -> list[LocatedPlace]:
        """Locate the places as an answer does."""
        radius = indexed.place_radius_px
        return [
            _on_path(locate(p, calibration=calibration, place_radius_px=radius), indexed.paths, floor=p.floor)
            for p in self.places
        ]


@dataclass(frozen=True, slots=True, eq=False)
class TriedMap:
    """A map whose photos are used as queries."""

    indexed: IndexedMap
    # Depth observations of the map's keypoints, to compute depths without the hidden photos; if None, no
    # depths are used.
    sightings: DepthObservations | None = None
    find: FindPlaces | None = None  # Finds the places of a query; `find_places` by default
    same_place_px: float = field(init=False)  # Photos within this distance show the same place

    def __post_init__(self) -> None:
        spacing = spacing_px(self.indexed.position, floor=self.indexed.floor)
        object.__setattr__(self, "same_place_px", _SAME_PLACE * (spacing or self.indexed.place_radius_px))

    @property
    def trials(self) -> int:
        """Number of trials, evenly spread over the map's photos."""
        return min(MOST_PHOTOS, len(self.indexed.ids))

    def attempt(self, number: int) -> TrialRecord:
        """Run a trial; None if it is not possible.

        Args:
            number: Number of the trial.
        """
        trial = _try(self, number * len(self.indexed.ids) // self.trials, number=number)
        return None if trial is None else trial.to_record()

    def attempt_adopted(self, photo: AdoptedPhoto) -> TrialRecord:
        """Localize a photo on the map as it was when it was asked about; None if it is not in the index."""
        mine = experiences_of(self.indexed.ids)
        numbers = np.flatnonzero(mine == photo.id)  # several if it is a panorama
        if len(numbers) != 1:
            return None
        without: NDArray[np.bool_] = (mine == photo.id) | (mine >= photo.newer)
        trial = self.localize(int(numbers[0]), without=without, hidden="later")
        return None if trial is None else trial.to_record()

    def localize(
        self,
        photo: int,
        *,
        without: NDArray[np.bool_],
        hidden: Hidden,
        features: Features | None = None,
    ) -> Trial | None:
        """Localize a photo of the map without some of them; None if it has no features, or none remains.

        Args:
            features: Of the photo, if they are not those in the index.
        """
        indexed = self.indexed
        features = features or indexed.features(photo)
        if features is None or without.all():
            return None
        started = time.thread_time()
        depths = {} if self.sightings is None else {"depths": DepthsExcluding(self.sightings, without)}
        find = self.find or partial(find_places, indexed)
        hide = indexed.ids[without].tolist()
        found = find(features, fov_deg=float(indexed.fov_deg[photo]), hide=hide, **depths)
        x, y = indexed.position[photo].tolist()
        strong = bool(found.places) and found.places[0].photos[0].inliers >= STRONG_INLIERS
        seconds, floor = time.thread_time() - started, int(indexed.floor[photo])
        return Trial(found.evidence, found.places, (x, y), hidden, strong, seconds, floor)


def try_photos(
    tried: TriedMap,
    progress: Progress,
    *,
    attempts: Callable[[Iterable[int]], Iterator[TrialRecord]] | None = None,
    known: Mapping[int, TrialRecord] = MappingProxyType({}),
    keep: Callable[[int, TrialRecord], None] = lambda number, trial: None,
) -> dict[int, Trial]:
    """Run trials on at most `MOST_PHOTOS` photos, evenly spread over the map.

    Args:
        attempts: Runs trials by number and yields the records in that order; by default one after the other,
            here.
        known: Trials of an earlier run.
        keep: Called with the number and the record of each new trial.

    Returns:
        By number; trials that are not possible are left out.
    """
    progress.size(tried.trials)
    new = (attempts or partial(map, tried.attempt))(n for n in range(tried.trials) if n not in known)
    trials = {}
    for number in range(tried.trials):
        progress.check()
        if number in known:
            record = known[number]
            progress.skip()
        else:
            record = next(new)
            keep(number, record)
            progress.advance()
        if record is not None:
            trials[number] = Trial.from_record(record)
    return trials


def with_queries(trials: Mapping[int, Trial], queries: Mapping[int, Trial]) -> dict[int, Trial]:
    """Add real queries to trials; their numbers become negative.

    The total weight of photos on the map is kept, and with it the prior that a query is on the map: the more
    real queries there are, the less the map's own photos count.
    """
    if not queries:
        return dict(trials)
    own = sum(trial.hidden != "surroundings" for trial in trials.values())
    real = len(queries) / (len(queries) + _TRIALS_AS_QUERIES) if own else 1.0
    each = real * own / len(queries) if own else 1.0
    found = {number: replace(trial, share=1.0 - real) for number, trial in trials.items()}
    return found | {-1 - number: replace(query, share=each) for number, query in queries.items()}


def _try(tried: TriedMap, photo: int, *, number: int) -> Trial | None:
    """Run one trial; None if the photo has no features, or no photo of the map remains."""
    features = tried.indexed.features(photo)
    if features is None:
        return None
    turn, which = divmod(number, len(_HIDDEN))
    hidden = _HIDDEN[which]
    if hidden == "place" and turn % _OTHER_DAY_EVERY == _OTHER_DAY_EVERY - 1:
        features = features.subset(np.arange(photo % _LEFT_ON_OTHER_DAY, len(features), _LEFT_ON_OTHER_DAY))
    without = _hide(tried, photo, features, hidden=hidden)
    return tried.localize(photo, without=without, hidden=hidden, features=features)


def _hide(tried: TriedMap, photo: int, features: Features, *, hidden: Hidden) -> NDArray[np.bool_]:
    """Choose the photos that are hidden in a trial; (p,)."""
    indexed = tried.indexed
    mine = experiences_of(indexed.ids)
    itself: NDArray[np.bool_] = mine == mine[photo]
    area = int(indexed.area[photo])
    away = np.hypot(*(indexed.position - indexed.position[photo]).T)
    apart: NDArray[np.float64] = np.where(indexed.floor == indexed.floor[photo], away, np.inf)
    if hidden == "photo":
        return itself
    if area >= 0:
        there: NDArray[np.bool_] = indexed.area == area
        return there if hidden == "surroundings" else there & _capture(indexed, itself, features)
    if hidden == "place":
        return apart <= tried.same_place_px
    within = min(
        _ELSEWHERE * indexed.place_radius_px, float(np.quantile(apart[np.isfinite(apart)], _MOST_HIDDEN))
    )
    return apart <= within


def _capture(indexed: IndexedMap, itself: NDArray[np.bool_], features: Features) -> NDArray[np.bool_]:
    """Find the photos of an area that appear to be from the same capture as the trial's photo."""
    neighbours = indexed.tuning.retrieval.neighbours + 1
    nearest = candidates(indexed, features.descriptors, k=neighbours, hide=indexed.ids[itself].tolist())
    votes = weighted_votes(filter_by_rotation(indexed, features, found=nearest), len(indexed.ids))
    same: NDArray[np.bool_] = votes > _ALIKE * votes.max()
    return itself | same


def _on_path(located: LocatedPlace, paths: PathPrior, *, floor: int) -> LocatedPlace:
    if located.kind != "position":
        return located
    position, _ = apply_path_prior(located.position, located.sigma_px**2, paths=paths, floor=floor)
    return replace(located, position=position)
