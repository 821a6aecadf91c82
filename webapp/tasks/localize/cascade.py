"""The looks of method `auto`: a fast one and, if that is uncertain, a second one with other features.

A look is the method `verified` with its own features, index and calibration. The second look uses learned
features; their matching network, if installed, matches the best photos.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from webapp.core.hypotheses import looks
from webapp.core.hypotheses.calibration import Calibration, Case, fit, probabilities
from webapp.core.hypotheses.model import Hypothesis
from webapp.files.localize import adopted
from webapp.files.localize import calibration as calibrationfile
from webapp.files.localize.calibration import StoredCalibration
from webapp.progress import Progress
from webapp.tasks.localize import calibrate
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.pipeline import Look, place_radius_px
from webapp.tasks.localize.trials import Trial

Pair = tuple[Look, Look]

_QUICKEST = 0.1
"""Quantile of the trials' CPU times that estimates the time of a trial on an idle machine."""

_SAME_AREAS = 0.9
"""Minimum share of the photos that both looks assign to the same kind: in an area, or not."""


OTHER_AREAS, TOO_SLOW = "its features show other areas", "it would exceed the time budget"


class JoinedLooks(NamedTuple):
    """The looks to use, and the joint calibration of two."""

    looks: tuple[Look, ...]
    both: StoredCalibration | None
    reason: str = ""
    """Why there is no second look."""
    is_uncalibrated: bool = False

    @property
    def calibration(self) -> Calibration:
        """The joint calibration; without effect on a single look."""
        return looks.DEFAULT if self.both is None else self.both.calibration


def join_looks(
    pair: Pair, *, budget_s: float, calibrated: Callable[[Pair], StoredCalibration | None]
) -> JoinedLooks:
    """Combine two looks if they are calibrated, show the same areas, and the second one is fast enough.

    Args:
        budget_s: Maximum time of the second look per photo on this machine, judged by the map's trials.
        calibrated: Returns the joint calibration; None if there is none.
    """
    first, second = pair
    if first.calibration is None or second.calibration is None:
        return JoinedLooks((first,), None, "it is not calibrated", is_uncalibrated=True)
    if not _share_areas(first.opened, second.opened):
        return JoinedLooks((first,), None, OTHER_AREAS)
    # The map is schematic for both looks if one of them found it to be.
    schematic = first.calibration.calibration.schematic or second.calibration.calibration.schematic
    agreed = _with_scale(first, schematic=schematic), _with_scale(second, schematic=schematic)
    both = calibrated(agreed)
    if both is None:
        return JoinedLooks((first,), None, "it is not calibrated", is_uncalibrated=True)
    if both.second_look_s > budget_s:
        return JoinedLooks((first,), None, TOO_SLOW)
    return JoinedLooks(agreed, both)


def _share_areas(first: OpenMap, second: OpenMap) -> bool:
    """Check whether both looks assign about the same photos to areas; else their answers differ in kind."""
    same = (first.indexed.area >= 0) == (second.indexed.area >= 0)
    return float(same.mean()) >= _SAME_AREAS


def _with_scale(look: Look, *, schematic: bool) -> Look:
    stored = _stored(look)
    calibration = replace(stored.calibration, schematic=schematic)
    return replace(look, calibration=replace(stored, calibration=calibration))


def _stored(look: Look) -> StoredCalibration:
    if look.calibration is None:
        raise ValueError("the look has to be calibrated")
    return look.calibration


def path(first: OpenMap, second: OpenMap) -> Path:
    """Return the file with the joint calibration of both looks; its name combines those of each look."""
    one, other = (calibrate.paths(o)[-1].stem for o in (first, second))
    return first.writable / f"{one}+{second.folder.folder.name}-{other}.json"


def stored_looks(file: Path) -> StoredCalibration | None:
    """Read the joint calibration of both looks; None if there is none."""
    return calibrationfile.read(file, numbers=looks.LOOKS)


def still_fits(known: StoredCalibration, pair: Pair) -> bool:
    """Check whether a joint calibration can still be used, as the map has changed little since."""
    return calibrate.still_fits(known, pair[0].opened, place_radius_px=place_radius_px(pair))


def calibrate_looks(pair: Pair, *, progress: Progress) -> StoredCalibration:
    """Return the stored joint calibration if it still fits the map, else fit it on the trials of both looks.

    Raises Cancelled, StorageError.
    """
    first, second = (look.opened for look in pair)
    known = stored_looks(path(first, second))
    if known is not None and still_fits(known, pair):
        return known
    started = time.perf_counter()
    one, other = (calibrate.run_all(o, progress=progress) for o in (first, second))
    stored = StoredCalibration(
        _fit_looks((one, other), pair),
        first.plan.map_fov_deg,
        place_radius_px(pair),
        calibrate.photo_keys(first),
        time.perf_counter() - started,
        second_look_s=_undisturbed_s(other.values()),
        queries=sum(number < 0 for number in one.keys() & other.keys()),
        queries_key=calibrate.queries_key(first.cfg),
        adopted=len(adopted.read(first.cfg)),
    )
    calibrationfile.write(path(first, second), stored)
    return stored


def _undisturbed_s(trials: Collection[Trial]) -> float:
    """Estimate the time of a trial on an idle machine: beside other work, CPU time grows, too, but less."""
    return float(np.quantile([t.seconds for t in trials], _QUICKEST)) if trials else 0.0


def _fit_looks(trials: tuple[Mapping[int, Trial], Mapping[int, Trial]], pair: Pair) -> Calibration:
    """Fit the weight of each look on the trials that both have run."""
    radius = place_radius_px(pair)
    cases = []
    for number in sorted(trials[0].keys() & trials[1].keys()):
        tried = [t[number] for t in trials]
        found = [_hypotheses(trial, look) for trial, look in zip(tried, pair, strict=True)]
        places, evidence = looks.evidence_of_looks(
            [hypotheses for hypotheses, _ in found], [off for _, off in found], radius_px=radius
        )
        answered = [looks.fuse_place(p, probability=0.0, place_radius_px=radius) for p in places]
        off = (tried[0].error_px(at.position, at.floor) for at in answered)
        right = np.array([error <= radius for error in off], np.bool_)
        cases.append(Case(evidence, right, tried[0].weight))
    slope, offset = fit(cases, start=looks.DEFAULT)
    return replace(looks.DEFAULT, slope=slope, offset=offset, cases=len(cases))


def _hypotheses(trial: Trial, look: Look) -> tuple[list[Hypothesis], float]:
    """Return the hypotheses that a look would have given, and its probability of "not on this map"."""
    if not trial.places:
        return [], 1.0
    indexed, calibration = look.opened.indexed, _stored(look).calibration
    probability, off_map = probabilities(trial.evidence, calibration)
    located = trial.located(indexed, calibration)
    return [
        Hypothesis(
            rank=rank,
            kind=at.kind,
            position=at.position,
            probability=float(p),
            radius_px=None if at.kind == "area" else min(at.sigma_px, indexed.place_radius_px),
            heading_deg=None,
            experiences=(),
            inliers=None,
            matches=0,
            floor=place.floor,
        )
        for rank, (at, p, place) in enumerate(zip(located, probability, trial.places, strict=True), 1)
    ], off_map
