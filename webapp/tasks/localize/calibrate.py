"""Fits a map's probabilities on its own photos: each is hidden and looked for (leave one place out)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import DEFAULT, EVIDENCE, Calibration, Case, fit, probabilities
from webapp.core.hypotheses.path_prior import PathPrior, apply_path_prior
from webapp.core.hypotheses.places import spacing_px
from webapp.core.localize.places import PlaceCandidate
from webapp.core.localize.verified import LocatedPlace, find_places, locate
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.core.retrieval.indexed import IndexedMap, candidates
from webapp.core.retrieval.shortlist import filter_by_rotation, weighted_votes
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.calibration import StoredCalibration, Trial, resumed_trials
from webapp.progress import Progress
from webapp.settings import RetrievalSettings
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_map import OpenMap

Hidden = Literal["photo", "place", "surroundings"]

MOST_PHOTOS = 200

_HIDDEN: tuple[Hidden, ...] = ("photo", "surroundings", "photo", "place")
"""What is hidden with a photo that plays a query, in turn: itself, as when somebody comes by again; what
stands as near as the next place; and all around, so that it plays a photo from elsewhere."""

_OFF_MAP_WEIGHT = 0.1
"""Of a photo from elsewhere against one from the map; ten of eleven are taken to be from the map."""

_SAME_PLACE = 1.05
"""Photos nearer than this, in spacings of the map, are hidden with a photo that plays a query: what is
left is about as far from it as a map's photos are from a new one."""

_ELSEWHERE, _MOST_HIDDEN = 10.0, 0.6
"""Photos nearer than this, in place radii, are hidden with a photo that plays one from elsewhere: along a
path one sees far. At most about this share of the map is hidden, the nearest photos."""

_OTHER_DAY_EVERY, _LEFT_ON_OTHER_DAY = 2, 10
"""Every second photo whose place is hidden plays one of another day, when one in ten of its keypoints is
found again."""

_CHANGED_SHARE = 0.1
"""A map that changed by less, in its photos and their places or its place radius, keeps its calibration."""

_PREFIX = 8
"""Characters of a content hash that are enough to tell whether a map has changed much."""

_ALIKE = 0.5
"""Photos of an area with more than this share of the most similar one's votes are of the same capture."""

_FEWEST_RADII = 10

_STRONG_INLIERS = 40
"""Inliers from which on a photo surely shows the same as the query."""

_PHOTO_SIGMAS = (0.5, 0.25, 1.0, 3.0)
"""How far a query may be from its best photo, place radii; the first unless another is better."""

_BETTER = 0.025
"""By so much of the answers, at least."""

_OFF, _CONTRADICTED, _PER_ERROR = 0.525, 0.1, 2
"""A map is schematic where computed positions are off by more than this, place radii, and photos are not, for
more than this share of the photos, and so many times as often as the other way round. On a path the nearest
photo left stands half a place radius away."""
_COVERAGE = 0.68


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A photo of the map that played a query.

    Attributes
    ----------
    evidence : (h, EVIDENCE) float64
    places : list of PlaceCandidate
        Their photos are left out.
    truth : (x, y)
    strong : bool
        The best photo surely shows the same.
    """

    evidence: NDArray[np.float64]
    places: list[PlaceCandidate]
    truth: tuple[float, float]
    hidden: Hidden
    strong: bool

    def to_record(self) -> dict[str, Any]:
        """Give plain values."""
        places = [[p.kind, *p.position, p.sigma_px, *p.anchor, p.area] for p in self.places]
        return {
            "evidence": self.evidence.tolist(),
            "places": places,
            "truth": [*self.truth],
            "hidden": self.hidden,
            "strong": self.strong,
        }

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> _Trial:
        """Build it from plain values."""
        places = [
            PlaceCandidate(kind, MapPixel(x, y), None, sigma, [], 0.0, MapPixel(ax, ay), area)
            for kind, x, y, sigma, ax, ay, area in record["places"]
        ]
        evidence = np.array(record["evidence"], np.float64).reshape(-1, EVIDENCE)
        x, y = record["truth"]
        return cls(evidence, places, (x, y), record["hidden"], record["strong"])

    def located(self, indexed: IndexedMap, calibration: Calibration) -> list[LocatedPlace]:
        """Locate the places as an answer does."""
        radius = indexed.place_radius_px
        return [
            _on_paths(locate(p, calibration=calibration, place_radius_px=radius), indexed.paths)
            for p in self.places
        ]


def calibrate_map(opened: OpenMap, *, map_fov_deg: float | None, progress: Progress) -> StoredCalibration:
    """Take the stored calibration where it still fits the map, else make and store a new one.

    Parameters
    ----------
    map_fov_deg : float or None
        As given for photos that do not tell theirs.
    progress : Progress
        One step a photo.

    Raises
    ------
    Cancelled, StorageError
    """
    for there in paths(opened):
        known = calibrationfile.read(there)
        if known is not None and still_fits(known, opened, map_fov_deg=map_fov_deg):
            return known
    photos, radius = _photos(opened), opened.indexed.place_radius_px
    progress.note("calibrating the probabilities")
    started = time.perf_counter()
    key = f"{calibrationfile.FORMAT} {opened.map_hash} {radius} {map_fov_deg}"
    path = paths(opened)[-1]
    with resumed_trials(path.with_suffix(".trials"), key) as (known_trials, keep):
        sightings = orient_map.sightings(opened, map_fov_deg=map_fov_deg)
        calibration = calibrate(opened.indexed, progress, sightings=sightings, known=known_trials, keep=keep)
    stored = StoredCalibration(calibration, map_fov_deg, radius, photos, time.perf_counter() - started)
    calibrationfile.write(path, stored)
    return stored


def paths(opened: OpenMap) -> tuple[Path, Path]:
    """Name the files in which a map's calibration may be; the last one is written."""
    verified = opened.indexed.tuning.retrieval.shortlist
    own = "" if verified == RetrievalSettings().shortlist else f"-shortlist{verified}"
    own += f"-{opened.indexed.kind}" if opened.indexed.kind_is_given else ""
    return opened.beside(f"calibration-{opened.method}-{opened.choice.matcher}{own}.json")


def still_fits(known: StoredCalibration, opened: OpenMap, *, map_fov_deg: float | None) -> bool:
    """Tell whether a map has changed so little since it was calibrated that this need not be repeated."""
    if known.map_fov_deg != map_fov_deg:
        return False
    changed = len(known.photos ^ _photos(opened)) > _CHANGED_SHARE * max(len(known.photos), 1)
    radius = opened.indexed.place_radius_px
    return not changed and abs(math.log(radius / known.place_radius_px)) <= _CHANGED_SHARE


def newest(opened: OpenMap) -> StoredCalibration | None:
    """Take the stored calibration, also where the map has changed much since; None where there is none."""
    known = (calibrationfile.read(path) for path in reversed(paths(opened)))
    return next((k for k in known if k is not None), None)


def calibrate(
    indexed: IndexedMap,
    progress: Progress,
    *,
    sightings: DepthObservations | None = None,
    known: Mapping[int, Trial] = MappingProxyType({}),
    keep: Callable[[int, Trial], None] = lambda number, trial: None,
) -> Calibration:
    """Fit the calibration on at most `MOST_PHOTOS` photos of the map, evenly spread over it.

    Parameters
    ----------
    sightings : Sightings, optional
        Of the map's keypoints, for depths that do not rest on the hidden photos. Without them there are none.
    known : mapping of int to Trial
        Photos that an earlier run has tried.
    keep : callable
        Is given each other photo and its trial.
    """
    count = min(MOST_PHOTOS, len(indexed.ids))
    chosen = [i * len(indexed.ids) // count for i in range(count)]
    progress.size(count)
    trials: list[_Trial] = []
    for number, photo in enumerate(chosen):
        progress.check()
        if number in known:
            tried = known[number]
        else:
            turn, which = divmod(number, len(_HIDDEN))
            hidden = _HIDDEN[which]
            other_day = hidden == "place" and turn % _OTHER_DAY_EVERY == _OTHER_DAY_EVERY - 1
            trial = _try(indexed, photo, sightings, hidden=hidden, other_day=other_day)
            tried = None if trial is None else trial.to_record()
            keep(number, tried)
        trials += [] if tried is None else [_Trial.from_record(tried)]
        progress.advance()
    return fit_trials(indexed, trials)


def fit_trials(indexed: IndexedMap, trials: Sequence[_Trial]) -> Calibration:
    """Fit first what a position and a photo are worth, then the probabilities of what comes of it."""
    fitted = replace(DEFAULT, schematic=_is_schematic(indexed, trials), cases=len(trials))
    if not fitted.schematic:
        fitted = replace(fitted, photo_sigma=_photo_sigma(indexed, trials))
    located = [t.located(indexed, fitted) for t in trials]
    errors = [_errors(at, t.truth) for at, t in zip(located, trials, strict=True)]
    cases = [_case(t, e, indexed.place_radius_px) for t, e in zip(trials, errors, strict=True)]
    slope, offset = fit(cases)
    scale = _radius_scale(trials, located, errors=errors, place_radius_px=indexed.place_radius_px)
    return replace(fitted, slope=slope, offset=offset, radius_scale=scale)


def _case(trial: _Trial, errors: NDArray[np.float64], place_radius_px: float) -> Case:
    weight = _OFF_MAP_WEIGHT if trial.hidden == "surroundings" else 1.0
    return Case(trial.evidence, errors <= place_radius_px, weight)


def _errors(located: Sequence[LocatedPlace], truth: tuple[float, float]) -> NDArray[np.float64]:
    return np.array([math.dist(one.position, truth) for one in located])


def _try(
    indexed: IndexedMap,
    photo: int,
    sightings: DepthObservations | None,
    *,
    hidden: Hidden,
    other_day: bool,
) -> _Trial | None:
    features = indexed.features(photo)
    if features is None:
        return None
    if other_day:
        features = features.subset(np.arange(photo % _LEFT_ON_OTHER_DAY, len(features), _LEFT_ON_OTHER_DAY))
    without = _hide(indexed, photo, features, hidden=hidden)
    if without.all():
        return None  # nothing of the map is left to be looked through
    found = find_places(
        indexed,
        features,
        fov_deg=float(indexed.fov_deg[photo]),
        hide=indexed.ids[without].tolist(),
        depths=None if sightings is None else DepthsExcluding(sightings, without),
    )
    x, y = indexed.position[photo].tolist()
    strong = bool(found.places) and found.places[0].photos[0].inliers >= _STRONG_INLIERS
    return _Trial(found.evidence, found.places, (x, y), hidden, strong)


def _hide(indexed: IndexedMap, photo: int, features: Features, *, hidden: Hidden) -> NDArray[np.bool_]:
    """Choose the photos that are hidden with one that plays a query; (p,)."""
    itself: NDArray[np.bool_] = np.arange(len(indexed.ids)) == photo
    area = int(indexed.area[photo])
    apart: NDArray[np.float64] = np.hypot(*(indexed.position - indexed.position[photo]).T)
    if hidden == "photo":
        return itself
    if area >= 0:
        there: NDArray[np.bool_] = indexed.area == area
        return there if hidden == "surroundings" else there & _capture(indexed, itself, features)
    if hidden == "place":
        spacing = spacing_px(indexed.position) or indexed.place_radius_px
        return apart <= _SAME_PLACE * spacing
    within = min(_ELSEWHERE * indexed.place_radius_px, float(np.quantile(apart, _MOST_HIDDEN)))
    return apart <= within


def _capture(indexed: IndexedMap, itself: NDArray[np.bool_], features: Features) -> NDArray[np.bool_]:
    """Find the photos that look as if they were taken with one: many share a place, and few a moment."""
    neighbours = indexed.tuning.retrieval.neighbours + 1
    nearest = candidates(indexed, features.descriptors, k=neighbours, hide=indexed.ids[itself].tolist())
    votes = weighted_votes(filter_by_rotation(indexed, features, found=nearest), len(indexed.ids))
    same: NDArray[np.bool_] = votes > _ALIKE * votes.max()
    return itself | same


def _on_paths(located: LocatedPlace, paths: PathPrior) -> LocatedPlace:
    if located.kind != "position":
        return located
    position, _ = apply_path_prior(located.position, located.sigma_px**2, paths=paths)
    return replace(located, position=position)


def _first_positions(trials: Sequence[_Trial]) -> list[tuple[PlaceCandidate, _Trial]]:
    """Take the best computed place of each photo that was hidden alone and surely found."""
    computed = [(next((p for p in t.places if p.kind == "position"), None), t) for t in trials]
    return [(p, t) for p, t in computed if p is not None and t.hidden == "photo" and t.strong]


def _is_schematic(indexed: IndexedMap, trials: Sequence[_Trial]) -> bool:
    """Decide whether computed positions contradict the map: wrong where the photo that matches is right."""
    if indexed.kind_is_given:
        return indexed.kind == "schematic"
    limit = _OFF * indexed.place_radius_px
    firsts = _first_positions(trials)
    off = [(math.dist(p.position, t.truth) > limit, math.dist(p.anchor, t.truth) > limit) for p, t in firsts]
    contradicted = sum(position and not photo for position, photo in off)
    corrected = sum(photo and not position for position, photo in off)
    enough = len(firsts) >= _FEWEST_RADII
    return enough and contradicted > _CONTRADICTED * len(firsts) + _PER_ERROR * corrected


def _photo_sigma(indexed: IndexedMap, trials: Sequence[_Trial]) -> float:
    """Choose how much the best photo's place says beside a computed position."""
    chosen, least = DEFAULT.photo_sigma, math.inf
    firsts = _first_positions(trials)
    if len(firsts) < _FEWEST_RADII:
        return chosen
    radius = indexed.place_radius_px
    for sigma in _PHOTO_SIGMAS:
        calibration = replace(DEFAULT, photo_sigma=sigma)
        errors = np.array(
            [
                math.dist(locate(p, calibration=calibration, place_radius_px=radius).position, t.truth)
                for p, t in firsts
            ]
        )
        off = float((errors > radius).mean() + (errors > radius / 2.0).mean())
        if off < least - _BETTER:
            chosen, least = sigma, off
    return chosen


def _radius_scale(
    trials: Sequence[_Trial],
    located: Sequence[list[LocatedPlace]],
    *,
    errors: Sequence[NDArray[np.float64]],
    place_radius_px: float,
) -> float:
    """Scale the stated spreads so that the radius held the truth in 68 % of the right answers.

    Never down: a map's own photos are easier than those that come later.
    """
    ratios = []
    for trial, at, error in zip(trials, located, errors, strict=True):
        if not at or trial.hidden == "surroundings":
            continue
        first = int(probabilities(trial.evidence, DEFAULT)[0].argmax())
        if error[first] <= place_radius_px and at[first].kind == "position":
            ratios.append(float(error[first]) / at[first].sigma_px)
    if len(ratios) < _FEWEST_RADII:
        return DEFAULT.radius_scale
    return max(float(np.quantile(ratios, _COVERAGE)), 1.0)


def _photos(opened: OpenMap) -> frozenset[str]:
    """Describe each photo by its content and the cell, about a place radius wide, that it stands in."""
    cell = 2.0 ** round(math.log2(opened.indexed.place_radius_px))
    cells = np.floor(opened.indexed.position / cell).astype(int).tolist()
    return frozenset(f"{c[:_PREFIX]}@{x},{y}" for c, (x, y) in zip(opened.contents, cells, strict=True) if c)
