"""Fits a map's probabilities on its own photos: each is hidden and looked for (leave one place out)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.hypotheses.calibration import DEFAULT, EVIDENCE, Calibration, Case, fit, probabilities
from webapp.core.hypotheses.path_prior import PathPrior, apply_path_prior
from webapp.core.hypotheses.places import spacing_px
from webapp.core.localize.places import PlaceCandidate
from webapp.core.localize.verified import find_places
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.core.retrieval.indexed import IndexedMap
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.calibration import StoredCalibration, Trial, resumed_trials
from webapp.progress import Progress
from webapp.settings import RetrievalSettings
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_map import OpenMap

MOST_PHOTOS = 200

_OFF_MAP_EVERY = 2
_OFF_MAP_WEIGHT = 0.1
"""Every second photo plays a photo from elsewhere; ten of eleven photos are taken to be from the map."""

_SAME_PLACE = 1.05
"""Photos nearer than this, in spacings of the map, are hidden with a photo that plays a query: what is
left is about as far from it as a map's photos are from a new one."""

_ELSEWHERE, _MOST_HIDDEN = 10.0, 0.6
"""Photos nearer than this, in place radii, are hidden with a photo that plays one from elsewhere: along a
path one sees far. At most about this share of the map is hidden, the nearest photos."""

_OTHER_DAY_EVERY, _LEFT_ON_OTHER_DAY = 4, 10
"""Every fourth photo plays one of another day, when one in ten of its keypoints is found again."""

_CHANGED_SHARE = 0.1
"""A map that changed by less, in its photos and their places or its place radius, keeps its calibration."""

_PREFIX = 8
"""Characters of a content hash that are enough to tell whether a map has changed much."""

_FEWEST_RADII = 10
_COVERAGE = 0.68


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    case: Case
    sigma_px: float
    error_px: float

    def to_record(self) -> dict[str, Any]:
        """Give plain values."""
        case = {"evidence": self.case.evidence.tolist(), "right": self.case.right.tolist()}
        return {**case, "weight": self.case.weight, "sigma_px": self.sigma_px, "error_px": self.error_px}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> _Trial:
        """Build it from plain values."""
        evidence = np.array(record["evidence"], np.float64).reshape(-1, EVIDENCE)
        case = Case(evidence, np.array(record["right"], np.bool_), record["weight"])
        return cls(case, record["sigma_px"], record["error_px"])


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
            other_day = number // _OFF_MAP_EVERY % _OTHER_DAY_EVERY == _OTHER_DAY_EVERY - 1
            trial = _try(indexed, photo, sightings, off_map=number % _OFF_MAP_EVERY == 1, other_day=other_day)
            tried = None if trial is None else trial.to_record()
            keep(number, tried)
        trials += [] if tried is None else [_Trial.from_record(tried)]
        progress.advance()
    slope, offset = fit([t.case for t in trials])
    fitted = Calibration(slope, offset, DEFAULT.radius_scale, len(trials))
    return _with_radius(fitted, trials)


def _try(
    indexed: IndexedMap, photo: int, sightings: DepthObservations | None, *, off_map: bool, other_day: bool
) -> _Trial | None:
    features = indexed.features(photo)
    if features is None:
        return None
    if other_day:
        features = features.subset(np.arange(photo % _LEFT_ON_OTHER_DAY, len(features), _LEFT_ON_OTHER_DAY))
    truth = indexed.position[photo]
    apart = np.hypot(*(indexed.position - truth).T)
    spacing = spacing_px(indexed.position) or indexed.place_radius_px
    within = _SAME_PLACE * spacing
    if off_map:
        within = min(_ELSEWHERE * indexed.place_radius_px, float(np.quantile(apart, _MOST_HIDDEN)))
    hidden = apart <= within
    if hidden.all():
        return None  # nothing of the map is left to be looked through
    found = find_places(
        indexed,
        features,
        fov_deg=float(indexed.fov_deg[photo]),
        hide=indexed.ids[hidden].tolist(),
        depths=None if sightings is None else DepthsExcluding(sightings, hidden),
    )
    places = found.places
    error = np.array([_error(p, truth, paths=indexed.paths) for p in places])
    case = Case(found.evidence, error <= indexed.place_radius_px, _OFF_MAP_WEIGHT if off_map else 1.0)
    if not places or off_map:
        return _Trial(case, np.nan, np.nan)
    first = int(probabilities(found.evidence, DEFAULT)[0].argmax())
    measures = case.right[first] and places[first].kind == "position"
    return _Trial(case, places[first].sigma_px, float(error[first]) if measures else np.nan)


def _error(place: PlaceCandidate, truth: NDArray[np.float64], *, paths: PathPrior) -> float:
    at = place.position
    if place.kind == "position":
        at, _ = apply_path_prior(at, place.sigma_px**2, paths=paths)
    return math.dist(at, truth)


def _with_radius(fitted: Calibration, trials: Sequence[_Trial]) -> Calibration:
    """Scale the stated spreads so that the radius held the truth in 68 % of the right answers.

    Never down: a map's own photos are easier than those that come later.
    """
    spread = np.array([t.sigma_px for t in trials])
    error = np.array([t.error_px for t in trials])
    right = np.isfinite(error)
    if right.sum() < _FEWEST_RADII:
        return fitted
    scale = float(np.quantile(error[right] / spread[right], _COVERAGE))
    return Calibration(fitted.slope, fitted.offset, max(scale, 1.0), fitted.cases)


def _photos(opened: OpenMap) -> frozenset[str]:
    """Describe each photo by its content and the cell, about a place radius wide, that it stands in."""
    cell = 2.0 ** round(math.log2(opened.indexed.place_radius_px))
    cells = np.floor(opened.indexed.position / cell).astype(int).tolist()
    return frozenset(f"{c[:_PREFIX]}@{x},{y}" for c, (x, y) in zip(opened.contents, cells, strict=True) if c)
