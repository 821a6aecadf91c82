"""The looks of method `auto`: a fast one and, if that is uncertain, a second one with other features.

A look is the method `verified` with its own features, index and calibration. The second look uses learned
features; their matching network, if installed, matches the best photos.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from webapp.core.features.table import FeatureChoice
from webapp.core.hypotheses import looks
from webapp.core.hypotheses.calibration import Calibration, Case, fit, probabilities
from webapp.core.hypotheses.model import Hypothesis
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.models import second_look_features
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import calibrate
from webapp.tasks.localize.index_location import index_bases, newest_choice
from webapp.tasks.localize.open_map import OpenMap, OpenOptions
from webapp.tasks.localize.trials import Trial

_QUICKEST = 0.1
"""Quantile of the trials' durations that estimates the time of a trial on an idle machine."""

_SAME_AREAS = 0.9
"""Minimum share of the photos that both looks assign to the same kind: in an area, or not."""


def look_options(
    options: OpenOptions, *, first: FeatureChoice, settings: Settings
) -> tuple[OpenOptions, ...]:
    """Resolve a method into its looks: two for `auto` if the models of the second one are installed.

    With explicitly named features there is a single look.

    Parameters
    ----------
    first : FeatureChoice
        The features that `auto` stands for in the first look.
    """
    if options.method != "auto":
        return (options,)
    one = replace(options, method="verified")
    if options.features != "auto" or options.detector or options.extractor or options.matcher:
        return (one,)
    second = second_look_features(settings.models)
    one = replace(one, detector=first.detector, extractor=first.extractor)
    if settings.retrieval.budget_s == 0.0 or second in (None, first.name):
        return (one,)
    return one, replace(options, method="verified", features=second, second_look=True)


def with_same_kind(second: OpenOptions, first: OpenMap) -> OpenOptions:
    """Let the second look use the kind of map that the first one determined.

    On a mixed map, each look determines the areas by itself; see `share_areas`.
    """
    kind = first.indexed.kind
    return second if kind == "mixed" else replace(second, map_kind=kind)


def newest_features(cfg: Path, options: OpenOptions, *, settings: Settings) -> FeatureChoice:
    """Resolve the features of the first look: those of the newest index, or else the default."""
    bases = index_bases(cfg, options.index)
    return newest_choice(bases, settings.extract, method="verified", matcher=None, models=settings.models)


def is_within_budget(both: StoredCalibration, settings: Settings) -> bool:
    """Check whether a second look is fast enough on this machine, judged by the map's trials."""
    return both.second_look_s <= settings.retrieval.budget_s


def share_areas(first: OpenMap, second: OpenMap) -> bool:
    """Check whether both looks assign about the same photos to areas; else their answers differ in kind."""
    same = (first.indexed.area >= 0) == (second.indexed.area >= 0)
    return float(same.mean()) >= _SAME_AREAS


def agree_on_scale(first: Calibration, second: Calibration) -> tuple[Calibration, Calibration]:
    """Mark the map as schematic for both looks if one of them found it to be."""
    schematic = first.schematic or second.schematic
    return replace(first, schematic=schematic), replace(second, schematic=schematic)


def path(first: OpenMap, second: OpenMap) -> Path:
    """Return the file with the joint calibration of both looks; its name combines those of each look."""
    one, other = (calibrate.paths(o)[-1].stem for o in (first, second))
    return first.writable / f"{one}+{second.folder.folder.name}-{other}.json"


def place_radius_px(opened: Sequence[OpenMap]) -> float:
    """Return the larger place radius: features with more matches detect more noise of the positions."""
    return max(o.indexed.place_radius_px for o in opened)


def stored_looks(file: Path) -> StoredCalibration | None:
    """Read the joint calibration of both looks; None if there is none."""
    return calibrationfile.read(file, numbers=looks.LOOKS)


def still_fits(known: StoredCalibration, opened: tuple[OpenMap, OpenMap]) -> bool:
    """Check whether a joint calibration can still be used, as the map has changed little since."""
    fov, radius = opened[0].options.map_fov_deg, place_radius_px(opened)
    return calibrate.still_fits(known, opened[0], map_fov_deg=fov, place_radius_px=radius)


def calibrate_looks(
    opened: tuple[OpenMap, OpenMap], calibrations: tuple[Calibration, Calibration], *, progress: Progress
) -> StoredCalibration:
    """Return the stored joint calibration if it still fits the map, else fit it on the trials of both looks.

    Raises
    ------
    Cancelled, StorageError
    """
    first, second = opened
    known = stored_looks(path(first, second))
    if known is not None and still_fits(known, opened):
        return known
    started = time.perf_counter()
    fov = first.options.map_fov_deg
    one, other = (calibrate.run_trials(o, map_fov_deg=fov, progress=progress) for o in opened)
    stored = StoredCalibration(
        fit_looks((one, other), opened, calibrations=calibrations),
        fov,
        place_radius_px(opened),
        calibrate.photo_keys(first),
        time.perf_counter() - started,
        second_look_s=_undisturbed_s(other.values()),
    )
    calibrationfile.write(path(first, second), stored)
    return stored


def _undisturbed_s(trials: Collection[Trial]) -> float:
    """Estimate the time of a trial on an idle machine: a concurrent build slows many trials down."""
    return float(np.quantile([t.seconds for t in trials], _QUICKEST)) if trials else 0.0


def fit_looks(
    trials: tuple[Mapping[int, Trial], Mapping[int, Trial]],
    opened: tuple[OpenMap, OpenMap],
    *,
    calibrations: tuple[Calibration, Calibration],
) -> Calibration:
    """Fit the weight of each look on the trials that both have run."""
    radius = place_radius_px(opened)
    cases = []
    for number in sorted(trials[0].keys() & trials[1].keys()):
        pair = [t[number] for t in trials]
        found = [_hypotheses(t, o, c) for t, o, c in zip(pair, opened, calibrations, strict=True)]
        places, evidence = looks.evidence_of_looks(
            [hypotheses for hypotheses, _ in found], [off for _, off in found], radius_px=radius
        )
        answered = [looks.fuse_place(p, probability=0.0, place_radius_px=radius) for p in places]
        off = (pair[0].error_px(at.position, at.floor) for at in answered)
        right = np.array([error <= radius for error in off], np.bool_)
        cases.append(Case(evidence, right, pair[0].weight))
    slope, offset = fit(cases, start=looks.DEFAULT)
    return replace(looks.DEFAULT, slope=slope, offset=offset, cases=len(cases))


def _hypotheses(trial: Trial, opened: OpenMap, calibration: Calibration) -> tuple[list[Hypothesis], float]:
    """Return the hypotheses that a look would have given, and its probability of "not on this map"."""
    if not trial.places:
        return [], 1.0
    probability, off_map = probabilities(trial.evidence, calibration)
    located = trial.located(opened.indexed, calibration)
    return [
        Hypothesis(
            rank=rank,
            kind=at.kind,
            position=at.position,
            probability=float(p),
            radius_px=None if at.kind == "area" else min(at.sigma_px, opened.indexed.place_radius_px),
            heading_deg=None,
            experiences=(),
            inliers=None,
            matches=0,
            floor=place.floor,
        )
        for rank, (at, p, place) in enumerate(zip(located, probability, trial.places, strict=True), 1)
    ], off_map
