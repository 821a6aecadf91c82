"""Calibrates a map's probabilities on trials: its own photos, hidden and used as queries."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.blank import why_blank
from webapp.core.features.global_descriptor import GlobalDescriptor
from webapp.core.features.types import Features
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.hypotheses.calibration import DEFAULT, Calibration, Case, fit, probabilities
from webapp.core.hypotheses.model import FieldOfView
from webapp.core.landmarks.cloud import AlignedCloud
from webapp.core.localize.landmarks import find_by_landmarks
from webapp.core.localize.places import LocatedPlace, PlaceCandidate, locate
from webapp.core.localize.verified import PlaceSearch, find_places
from webapp.core.retrieval.indexed import IndexedMap
from webapp.errors import PhotoError, TableError, UsageError
from webapp.files.contents import local
from webapp.files.localize import adopted, queries_csv
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.adopted import AdoptedPhoto
from webapp.files.localize.calibration import StoredCalibration, TrialRecord, recorded_trials
from webapp.files.localize.queries_csv import Query
from webapp.files.maps.folder import read_map
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits, RetrievalSettings
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.localize import geometry, orient_map
from webapp.tasks.localize.index_location import index_bases
from webapp.tasks.localize.open_index import MapSource, RebuiltValue
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.pipeline import Look
from webapp.tasks.localize.query_photo import read_query
from webapp.tasks.localize.trials import (
    MOST_PHOTOS,
    REAL,
    STRONG_INLIERS,
    Hidden,
    Trial,
    TriedMap,
    try_photos,
    with_queries,
)

_LANDMARK_EVIDENCE = 2
"""Part of the key of trials by landmarks: change it when their evidence is computed differently."""

_CHANGED_SHARE = 0.1
"""A map keeps its calibration while its photos, positions and place radius change by less than this."""

_ADOPTED_SHARE = 0.5
"""It keeps it while the number of adopted photos changes by at most this share: repeating it takes long."""

_PREFIX = 8
"""Characters of a content hash that suffice to detect whether a map has changed much."""

_FEWEST_RADII = 10
"""Minimum number of samples for fitting radii, and for a kind of trial to have its full weight."""

_PHOTO_SIGMAS = (DEFAULT.photo_sigma, 0.25, 0.5, 3.0)
"""Candidate distances of a query from its best-matching photo, place radii; the first is preferred."""

_BETTER = 0.01
"""Minimum improvement of the mean error, place radii, for another candidate to be chosen."""

_OFF, _CONTRADICTED, _PER_ERROR = 0.525, 0.1, 2
"""A trial contradicts the map if its computed position is off by more than `_OFF` place radii, but its best
photo is not (on a path, the nearest remaining photo is half a place radius away). A map is schematic if these
are more than a share `_CONTRADICTED` of the trials, plus `_PER_ERROR` times the number of opposite cases."""
_COVERAGE = 0.68


def calibrate_map(opened: OpenMap, *, progress: Progress) -> StoredCalibration:
    """Return the stored calibration if it still fits the map, else compute and store a new one.

    Raises Cancelled, StorageError.

    Args:
        progress: One step per trial.
    """
    for there in paths(opened):
        known = calibrationfile.read(there)
        if known is not None and still_fits(known, opened):
            return known
    radius = opened.indexed.place_radius_px
    progress.note("calibrating the probabilities")
    started = time.perf_counter()
    trials = run_all(opened, progress=progress)
    calibration = fit_trials(opened.indexed, [*trials.values()])
    stored = StoredCalibration(
        calibration,
        opened.plan.map_fov_deg,
        radius,
        photo_keys(opened),
        time.perf_counter() - started,
        queries=sum(trial.hidden in REAL for trial in trials.values()),
        queries_key=queries_key(opened.cfg),
        adopted=len(adopted.read(opened.cfg)),
    )
    calibrationfile.write(paths(opened)[-1], stored)
    return stored


def queries_file(cfg: Path) -> Path:
    """Return the list of a map's real queries with known positions, next to `map.cfg`."""
    return cfg.with_name(f"{cfg.stem}.queries.csv")


def queries_key(cfg: Path) -> str:
    """Return a digest of that list; empty without one. Raises TableError."""
    file = queries_file(cfg)
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    except FileNotFoundError:
        return ""
    except OSError as error:
        raise TableError(f"the list cannot be read: {error.strerror}", where=str(file)) from error


def keep_queries(cfg: Path, listed: Path, *, limits: PhotoLimits) -> None:
    """Keep a list of real queries for the next calibration, after checking that each photo can be read.

    Raises MapError, TableError, PhotoError, UsageError, StorageError.
    """
    if read_map(cfg).floors:
        raise UsageError("a list of queries does not state floors", where=str(cfg), hint="use a map of one")
    queries = queries_csv.read(listed)
    for query in queries:
        read_facts(query.path, limits=limits)
    queries_csv.write(queries_file(cfg), queries)


def run_all(opened: OpenMap, *, progress: Progress) -> dict[int, Trial]:
    """Run the trials of a map and localize its real queries, listed and adopted ones; see `with_queries`.

    Raises Cancelled, StorageError, TableError.
    """
    trials = run_trials(opened, progress=progress)
    key, photos = queries_key(opened.cfg), adopted.read(opened.cfg)
    real: list[Query | AdoptedPhoto] = [*photos[-MOST_PHOTOS:]]
    real += queries_csv.read(queries_file(opened.cfg)) if key else []
    if not real:
        return trials
    progress.note("calibrating on real queries")
    progress.size(len(real))
    found: dict[int, Trial] = {}
    at = paths(opened)[-1].with_suffix(".queries")
    with recorded_trials(at, f"{_trials_key(opened)} {key} {[*map(tuple, photos)]}") as (known, keep):
        tried = _tried(opened)
        for number, query in enumerate(real):
            progress.check()
            if number not in known:
                try:
                    if isinstance(query, AdoptedPhoto):
                        known[number] = tried.attempt_adopted(query)
                    else:
                        known[number] = _try_query(opened, query, progress=progress)
                except PhotoError as error:  # moved away since: the others still count
                    progress.note(str(error))
                    continue
                keep(number, known[number])
            if (record := known[number]) is not None:
                found[number] = Trial.from_record(record)
            progress.advance()
    return with_queries(trials, found)


def _try_query(opened: OpenMap, query: Query, *, progress: Progress) -> TrialRecord:
    """Localize a real query; None for a panorama, or a photo with nothing to recognise. Raises PhotoError."""
    described = opened.indexed.global_descriptors
    describe = None if described is None else described.network
    photos = read_query(local(query.path), settings=opened.settings, fov_deg=None, describe=describe)
    features = Look(opened).extract(photos[0])
    if len(photos) > 1 or why_blank(photos[0].gray.pixels, features):
        progress.note(f"{query.name} is not used: a panorama, or nothing to recognise")
        return None
    started = time.perf_counter()
    find = _tried(opened).find or partial(find_places, opened.indexed)
    found = find(features, fov_deg=photos[0].fov.degrees)
    strong = bool(found.places) and found.places[0].photos[0].inliers >= STRONG_INLIERS
    seconds = time.perf_counter() - started
    return Trial(found.evidence, found.places, (*query.truth,), "nothing", strong, seconds).to_record()


def run_trials(opened: OpenMap, *, progress: Progress) -> dict[int, Trial]:
    """Run the trials of a map; those that an earlier run recorded are not repeated.

    Raises Cancelled, StorageError.

    Returns:
        See `try_photos`.
    """
    with recorded_trials(paths(opened)[-1].with_suffix(".trials"), _trials_key(opened)) as (known, keep):
        tried = _tried(opened)
        again = RebuiltValue(partial(_open_again, MapSource.of(opened)), tried)
        attempts = partial(
            in_order,
            _attempt,
            shared=again,
            at=ExecutionTarget(opened.settings, opened.writable),
            progress=progress,
        )
        return try_photos(tried, progress, attempts=attempts, known=known, keep=keep)


def _trials_key(opened: OpenMap) -> str:
    """Identify all that trials depend on."""
    radius, fov_deg = opened.indexed.place_radius_px, opened.plan.map_fov_deg
    key = f"{calibrationfile.TRIALS_FORMAT} {opened.map_hash} {radius} {fov_deg}"
    return key if opened.landmarks is None else f"{key} {opened.landmarks.key} {_LANDMARK_EVIDENCE}"


def _tried(opened: OpenMap) -> TriedMap:
    if opened.landmarks is not None:
        return TriedMap(opened.indexed, find=partial(_find_by_landmarks, opened.indexed, opened.landmarks))
    return TriedMap(opened.indexed, orient_map.sightings(opened))


def _find_by_landmarks(
    indexed: IndexedMap, aligned: AlignedCloud, features: Features, *, fov_deg: float, hide: Collection[int]
) -> PlaceSearch:
    fov = FieldOfView(fov_deg, "exif")
    return find_by_landmarks(indexed, features, fov=fov, aligned=aligned, hide=hide)


def _open_again(files: MapSource) -> TriedMap:
    return _tried(geometry.prepare_geometry(files.open(), progress=Progress()))


def _attempt(tried: RebuiltValue[TriedMap], number: int) -> TrialRecord:
    return tried.value().attempt(number)


def paths(opened: OpenMap) -> tuple[Path, Path]:
    """Return the possible files of a map's calibration; the last one is written."""
    described = opened.indexed.global_descriptors
    return paths_with(opened, None if described is None else described.network)


def paths_with(opened: OpenMap, network: GlobalDescriptor | None) -> tuple[Path, Path]:
    """Return the files of the calibration with a global descriptor, or without one."""
    verified = opened.indexed.tuning.retrieval.shortlist
    by_network = opened.indexed.pair_matcher is not None and opened.method != "thorough"
    own = "-network" if by_network else ""
    own += "" if verified == RetrievalSettings().shortlist else f"-shortlist{verified}"
    own += f"-{opened.indexed.kind}" if opened.indexed.kind_is_given else ""
    own += "" if network is None else f"-global{network.weights[:8]}"
    return opened.artifact_paths(f"calibration-{opened.method}-{opened.choice.matcher}{own}.json")


def still_fits(known: StoredCalibration, opened: OpenMap, *, place_radius_px: float | None = None) -> bool:
    """Check whether a calibration can still be used, as the map has changed little since.

    Args:
        place_radius_px: Place radius, if it is not the map's own.
    """
    if known.map_fov_deg != opened.plan.map_fov_deg or known.queries_key != queries_key(opened.cfg):
        return False
    photos = len(adopted.read(opened.cfg))
    if abs(photos - known.adopted) > _ADOPTED_SHARE * min(photos, known.adopted):
        return False
    changed = len(known.photos ^ photo_keys(opened)) > _CHANGED_SHARE * max(len(known.photos), 1)
    radius = place_radius_px or opened.indexed.place_radius_px
    return not changed and abs(math.log(radius / known.place_radius_px)) <= _CHANGED_SHARE


def newest(opened: OpenMap) -> StoredCalibration | None:
    """Return the stored calibration, even if the map has changed much since; None if there is none."""
    known = (calibrationfile.read(path) for path in reversed(paths(opened)))
    return next((k for k in known if k is not None), None)


class CalibratedOn(NamedTuple):
    """How many photos a calibration was fitted on."""

    own: int
    real: int


def calibrated_on(cfg: Path) -> CalibratedOn | None:
    """Return what the newest calibration of a map was fitted on; None if there is none."""
    files = [file for base in index_bases(cfg, None) for file in base.glob("*/calibration-*.json")]
    files.sort(key=lambda file: file.stat().st_mtime_ns, reverse=True)
    known = next((k for k in map(calibrationfile.read, files) if k is not None), None)
    return None if known is None else CalibratedOn(known.calibration.cases - known.queries, known.queries)


def fit_trials(indexed: IndexedMap, trials: Sequence[Trial], *, start: Calibration = DEFAULT) -> Calibration:
    """Fit the weights of computed and photo positions, then the probabilities of the resulting positions.

    Args:
        start: The fit is regularised towards it.
    """
    fitted = replace(DEFAULT, schematic=_is_schematic(indexed, trials), cases=len(trials))
    if not fitted.schematic:
        fitted = replace(fitted, photo_sigma=_photo_sigma(indexed, trials))
    located = [t.located(indexed, fitted) for t in trials]
    errors = [_errors(at, t) for at, t in zip(located, trials, strict=True)]
    cases = [_case(t, e, indexed.place_radius_px) for t, e in zip(trials, errors, strict=True)]
    slope, offset = fit(cases, start=start)
    scale = _radius_scale(trials, located, errors=errors, place_radius_px=indexed.place_radius_px)
    return replace(fitted, slope=slope, offset=offset, radius_scale=scale)


def _case(trial: Trial, errors: NDArray[np.float64], place_radius_px: float) -> Case:
    return Case(trial.evidence, errors <= place_radius_px, trial.weight)


def _errors(located: Sequence[LocatedPlace], trial: Trial) -> NDArray[np.float64]:
    pairs = zip(located, trial.places, strict=True)
    return np.array([trial.error_px(one.position, place.floor) for one, place in pairs])


def _first_positions(trials: Sequence[Trial]) -> list[tuple[PlaceCandidate, Trial]]:
    """Return the best computed place of each trial with at most the photo hidden and a certain match."""
    computed = [(next((p for p in t.places if p.kind == "position"), None), t) for t in trials]
    return [(p, t) for p, t in computed if p is not None and t.hidden in ("photo", "nothing") and t.strong]


def _is_schematic(indexed: IndexedMap, trials: Sequence[Trial]) -> bool:
    """Decide whether a map is schematic: computed positions are often wrong, but matched photos right."""
    if indexed.kind_is_given:
        return indexed.kind == "schematic"
    limit = _OFF * indexed.place_radius_px
    firsts = _first_positions(trials)
    off = [
        (t.error_px(p.position, p.floor) > limit, t.error_px(p.anchor, p.floor) > limit) for p, t in firsts
    ]
    contradicted = sum(position and not photo for position, photo in off)
    corrected = sum(photo and not position for position, photo in off)
    enough = len(firsts) >= _FEWEST_RADII
    return enough and contradicted > _CONTRADICTED * len(firsts) + _PER_ERROR * corrected


def _photo_sigma(indexed: IndexedMap, trials: Sequence[Trial]) -> float:
    """Choose the weight of the best photo's position relative to a computed one.

    The criterion is the mean error, clipped at the place radius. (On a walk with evenly spaced photos, the
    number of errors below a limit hardly depends on the weight.)
    """
    chosen, least = DEFAULT.photo_sigma, math.inf
    firsts = _first_positions(trials)
    if len(firsts) < _FEWEST_RADII:
        return chosen
    radius = indexed.place_radius_px
    for sigma in _PHOTO_SIGMAS:
        calibration = replace(DEFAULT, photo_sigma=sigma)
        errors = np.array(
            [
                t.error_px(locate(p, calibration=calibration, place_radius_px=radius).position, p.floor)
                for p, t in firsts
            ]
        )
        mean = float(np.minimum(errors / radius, 1.0).mean())
        if mean < least - _BETTER:
            chosen, least = sigma, mean
    return chosen


def _radius_scale(
    trials: Sequence[Trial],
    located: Sequence[list[LocatedPlace]],
    *,
    errors: Sequence[NDArray[np.float64]],
    place_radius_px: float,
) -> float:
    """Scale the estimated spreads so that the radius contains the truth in 68 % of the correct answers.

    A photo hidden alone is too easy, with neighbours of the same walk on both sides; one hidden with its
    place is too hard, as the remaining photos are farther away than from most queries. Both kinds have equal
    weight regardless of their numbers, but a kind with few samples has less. The scale is at least 1, as a
    map's own photos are easier than later queries.
    """
    ratios: dict[Hidden, list[float]] = {"photo": [], "place": [], "nothing": []}
    for trial, at, error in zip(trials, located, errors, strict=True):
        # an adopted photo may have been placed where the answer said
        if not at or trial.hidden in ("surroundings", "later"):
            continue
        first = int(probabilities(trial.evidence, DEFAULT)[0].argmax())
        if error[first] <= place_radius_px and at[first].kind == "position":
            ratios[trial.hidden].append(float(error[first]) / at[first].sigma_px)
    if len(ratios["nothing"]) >= _FEWEST_RADII:
        ratios = {"nothing": ratios["nothing"]}
    if sum(map(len, ratios.values())) < _FEWEST_RADII:
        return DEFAULT.radius_scale
    weights = [np.full(len(r), 1.0 / max(len(r), _FEWEST_RADII)) for r in ratios.values()]
    return max(_quantile(np.concatenate([*ratios.values()]), np.concatenate(weights), at=_COVERAGE), 1.0)


def _quantile(values: NDArray[np.float64], weights: NDArray[np.float64], *, at: float) -> float:
    """Compute a weighted quantile, interpolated between the midpoints of the weights."""
    order = np.argsort(values, kind="stable")
    share = (np.cumsum(weights[order]) - weights[order] / 2.0) / weights.sum()
    return float(np.interp(at, share, values[order]))


def photo_keys(opened: OpenMap) -> frozenset[str]:
    """Return a key per photo: content hash, and grid cell (about a place radius wide) of its position."""
    cell = 2.0 ** round(math.log2(opened.indexed.place_radius_px))
    cells = np.floor(opened.indexed.position / cell).astype(int).tolist()
    floors = [f",{on}" if on != BASE_FLOOR else "" for on in opened.indexed.floor.tolist()]
    return frozenset(
        f"{c[:_PREFIX]}@{x},{y}{on}"
        for c, (x, y), on in zip(opened.contents, cells, floors, strict=True)
        if c
    )
