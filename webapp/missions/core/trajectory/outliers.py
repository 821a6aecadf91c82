"""Explains the fixes of a track: which are wrong, where the robot was carried, how noisy each source is.

A forward filter must judge each fix as it arrives. After a long distance its prediction is uncertain: it
accepts a wrong fix, and then rejects good ones. Here the whole track is explained at once, by the assumptions
of the highest evidence (see `evidence`). Assumptions about fixes and the noise are improved in turn, and the
track is linearised again about the result, until nothing changes.

The first track is estimated from the fixes whose distances from their neighbours agree with the odometry, or
without odometry, from the longest chain of fixes that the robot could reach one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.missions.core.trajectory.alignment import start
from webapp.missions.core.trajectory.evidence import (
    CARRIED,
    LEAST_ESTIMATED,
    OUTLIER_RADIUS_M,
    START_M,
    START_RAD,
    Factors,
    FixModel,
    Labels,
    distances,
    linearised,
    refine,
    search,
)
from webapp.missions.core.trajectory.motion import HEADING, POSITION, Noise
from webapp.missions.core.trajectory.smoother import AGREEING, AGREEING_S, Filter
from webapp.missions.core.trajectory.steps import Fixes, Floats, Steps, path

NEIGHBOURS = 4
"""Number of fixes before and after one with which it is compared."""

DISTANCE_TOLERANCE = 0.05
"""Tolerance of distances for scale and turn errors of the odometry, as a fraction of the path length."""

FASTEST = 3.0
"""Limit of the speed without odometry, in standard deviations of the velocity along an axis."""

BELIEVED = ("manual",)
"""Sources whose stated covariances are believed."""

CORRELATION_S = {"gps": 10.0}
"""Correlation times of the errors of sources with too few fixes to estimate them; 0 for others."""

TOO_SURE = 4.0
"""Factor from which the search begins for a source that may be too sure of itself."""

FIRST_MOTION = (0.25, 1.0)
"""Factors on the usual errors of odometry, or on the usual velocity, from which the search begins."""

COARSE, FINE = (2.0,), (2**0.5, 2**0.25)
"""Ratios by which factors are changed at first, and when the best explanation is known."""

_LINEARISED = 5
_ALTERNATED_FIRST, _ALTERNATED = 2, 6

CHANGED = 5.0
"""Least gain of log-evidence for which a source is split in two stretches of different noise."""


def kind(source: str) -> str:
    """Return the kind of a source: `gps` of the receiver `gps 12`."""
    return source.partition(" ")[0]


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The most probable assumptions about fixes and noise."""

    weight: Floats  # (m,) float64. 0 for a wrong or shifted fix, 1 for a good one.
    shifted: tuple[NDArray[np.intp], ...]  # Runs of fixes that are shifted together
    begins_s: tuple[float, ...]  # Start time of each piece, between which the robot was carried
    factors: Factors
    group: NDArray[np.intp]  # (m,) intp. Stretch of equal noise, of one source, of each fix.


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """A piece of a track, and its fixes."""

    steps: Steps
    piece: range  # Of nodes
    fixes: Fixes
    source: NDArray[np.str_]  # (m,)
    group: NDArray[np.intp]  # (m,): as in `Explanation`
    usual: Noise
    reckoned: bool  # Whether there is odometry
    check: Callable[[int], None]

    def within(self, piece: range) -> _Given:
        """Return a part of it."""
        mine = (self.fixes.node >= piece.start) & (self.fixes.node < piece.stop)
        return replace(
            self,
            piece=piece,
            fixes=self.fixes.take(mine),
            source=self.source[mine],
            group=self.group[mine],
        )


class _Assumed(NamedTuple):
    """Assumptions about fixes and noise, and the logarithm of their evidence."""

    labels: Labels
    factors: Factors
    evidence: float


def explain(
    steps: Steps,
    fixes: Fixes,
    *,
    source: NDArray[np.str_],
    usual: Noise,
    check: Callable[[int], None] = lambda _: None,
) -> Explanation:
    """Find the most probable assumptions.

    Args:
        fixes: At least one, some hundreds at most; their stated covariances.
        source: (m,) str. Where each fix came from.
        check: Called now and then; raises if the work was cancelled.
    """
    names, group = np.unique(source, return_inverse=True)
    counts = np.bincount(group)
    times = tuple(
        0.0 if counts[at] >= LEAST_ESTIMATED else CORRELATION_S.get(kind(name), 0.0)
        for at, name in enumerate(names.tolist())
    )
    given = _Given(
        steps,
        range(len(steps)),
        fixes,
        source,
        group.astype(np.intp),
        usual,
        bool(np.isfinite(steps.moves).any()),
        check,
    )
    factors = Factors(1.0, (1.0,) * len(names), times)
    pieces = _pieces(given, factors, fit=len(fixes) >= LEAST_ESTIMATED)
    weight, shifted = np.ones(len(fixes)), []
    for part, (labels, _, _) in pieces:
        mine = np.flatnonzero((fixes.node >= part.piece.start) & (fixes.node < part.piece.stop))
        weight[mine] = _weight(labels)
        shifted += [mine[run.members] for run in labels.runs]
    return Explanation(
        weight,
        tuple(shifted),
        tuple(float(steps.times_s[part.piece.start]) for part, _ in pieces),
        pieces[0][1].factors,
        np.concatenate([part.group for part, _ in pieces]),
    )


def _weight(labels: Labels) -> Floats:
    weight = np.where(labels.wrong, 0.0, 1.0)
    for run in labels.runs:
        weight[run.members] = 0.0
    return weight


def _pieces(given: _Given, factors: Factors, *, fit: bool) -> list[tuple[_Given, _Assumed]]:
    """Explain a piece, or two parts of it if the robot was carried between them."""
    given, whole = _explain(given, factors, fit=fit)
    labels, nodes = whole.labels, given.fixes.node
    carried = [int(nodes[run.members[0]]) for run in labels.runs if run.carried]
    split = (
        carried[0]
        if carried
        else _first_of_consistent_run(given.steps, given.fixes, gated=labels.wrong, noise=given.usual)
    )
    if split is None or not nodes[0] < split:
        return [(given, whole)]
    before, after = range(given.piece.start, split), range(split, given.piece.stop)
    parts = [
        part for piece in (before, after) for part in _pieces(given.within(piece), whole.factors, fit=False)
    ]
    together = sum(assumed.evidence for _, assumed in parts) + (len(parts) - 1) * math.log(CARRIED)
    return parts if carried or together > whole.evidence else [(given, whole)]


def _explain(given: _Given, factors: Factors, *, fit: bool) -> tuple[_Given, _Assumed]:
    """Find the best assumptions for a piece; if `fit`, also of its noise, which may split a group."""
    tried = []
    for motion in FIRST_MOTION if fit else (factors.motion,):
        first = replace(factors, motion=motion)
        begins = _first_labels(given, first)
        model = _model(given, _track(given, begins[0], first))
        options = _first_factors(model, first) if fit else [first]
        for labels, option in product(begins, options):
            given.check(0)
            tried.append((_alternate(model, labels, option, ratios=COARSE if fit else ()), model))
    best, model = max(tried, key=lambda pair: pair[0].evidence)
    for _ in range(_LINEARISED):
        given.check(0)
        if given.reckoned:  # else the model is linear
            model = _model(given, _track(given, best.labels, best.factors))
        last, best = best, _alternate(model, best.labels, best.factors, ratios=FINE if fit else ())
        if last.labels.key() == best.labels.key() and abs(last.evidence - best.evidence) < 0.1:
            break
    if fit:
        model, best = _with_changes(model, best)
    return replace(given, group=model.group), best


def _alternate(model: FixModel, labels: Labels, factors: Factors, *, ratios: tuple[float, ...]) -> _Assumed:
    """Improve labels and factors in turn.

    Args:
        ratios: By which factors are changed; none if they are known.
    """
    evidence = -math.inf
    for _ in range(_ALTERNATED_FIRST if ratios == COARSE else _ALTERNATED):
        before = labels.key()
        labels, found = search(model, labels, factors=factors)
        if not ratios:
            return _Assumed(labels, factors, found)
        factors, found = refine(model, labels, factors=factors, ratios=ratios)
        if found < evidence + 0.01 or labels.key() == before:
            return _Assumed(labels, factors, max(evidence, found))
        evidence = found
    return _Assumed(labels, factors, evidence)


def _with_changes(model: FixModel, best: _Assumed) -> tuple[FixModel, _Assumed]:
    """Split a source where its noise changes, if the evidence grows."""
    distance = distances(model, best.labels, factors=best.factors)
    for group in model.estimated:
        at = np.flatnonzero((model.group == group) & np.isfinite(distance))
        if len(at) < 2 * LEAST_ESTIMATED:
            continue
        count = np.arange(1, len(at))
        total = np.cumsum(np.maximum(distance[at], 1e-6)) / 2  # never 0: fixes may be all the same
        before, after = total[:-1] / count, (total[-1] - total[:-1]) / (len(at) - count)
        gain = -count * np.log(before) - (len(at) - count) * np.log(after)
        gain[: LEAST_ESTIMATED - 1] = gain[len(at) - LEAST_ESTIMATED :] = -math.inf
        change = int(np.argmax(gain))
        new, own = len(best.factors.stated), best.factors.stated[group]
        split = model.group.copy()
        split[(split == group) & (np.arange(len(model)) >= at[change + 1])] = new
        apart = replace(
            best.factors,
            stated=(*best.factors.stated, max(1.0, own * math.sqrt(after[change]))),
            correlated_s=(*best.factors.correlated_s, best.factors.correlated_s[group]),
        ).with_group(group, stated=max(1.0, own * math.sqrt(before[change])))
        other = replace(model, group=split, estimated=(*model.estimated, new))
        found = _alternate(other, best.labels, apart, ratios=FINE)
        if found.evidence > best.evidence + CHANGED:
            model, best = other, found
    return model, best


def _model(given: _Given, state: Floats) -> FixModel:
    steps, fixes = given.steps, given.fixes
    residual, begun, motion = linearised(steps, fixes, state=state, piece=given.piece, noise=given.usual)
    counts = np.bincount(given.group)
    names = {int(one): str(name) for one, name in zip(given.group, given.source, strict=True)}
    estimated = tuple(
        one
        for one, name in sorted(names.items())
        if kind(name) not in BELIEVED and counts[one] >= LEAST_ESTIMATED
    )
    radius = OUTLIER_RADIUS_M
    if not given.reckoned:  # a prediction is hardly better than any place on the way
        radius = max(radius, float(np.hypot(*np.ptp(fixes.position, axis=0))) / 2)
    return FixModel(
        residual,
        begun,
        motion,
        np.asarray(np.linalg.cholesky(fixes.covariance), dtype=np.float64),
        steps.times_s[fixes.node],
        given.group,
        estimated,
        given.source,
        given.reckoned,
        math.pi * radius**2,
    )


def scaled(usual: Noise, factors: Factors, *, reckoned: bool) -> Noise:
    """Return the noise of the motion under a factor."""
    by = factors.motion
    if not reckoned:
        return replace(usual, velocity=usual.velocity * by)
    names = ("forward", "sideways", "heading", "turning", "scale", "turn_scale", "curve")
    return replace(usual, **{name: getattr(usual, name) * by for name in names})


def _track(given: _Given, labels: Labels, factors: Factors) -> Floats:
    """Smooth the track (n, 8) under some assumptions, from a start that is hardly known."""
    steps, piece, weight = given.steps, given.piece, _weight(labels)
    if not weight.any():
        weight[:] = 1.0
    by = np.array(factors.stated)[given.group]
    fixes = replace(given.fixes, covariance=given.fixes.covariance * by[:, None, None] ** 2)
    noise = scaled(given.usual, factors, reckoned=given.reckoned)
    filter = Filter(steps, fixes, noise=noise, weight=weight)
    # with the usual noise of odometry, the first fixes would hardly determine a heading
    little = scaled(given.usual, replace(factors, motion=FIRST_MOTION[0]), reckoned=given.reckoned)
    begun = start(steps, fixes.take(weight > 0), begin=piece.start, noise=little)
    begun.covariance[POSITION, POSITION] += np.eye(2) * START_M**2
    begun.covariance[HEADING, HEADING] += (START_RAD / 4) ** 2
    for again in (False, True, True):
        filter.forward(piece.start, begun, check=given.check, end=piece.stop, around_last=again)
        filter.back(piece.start, piece.stop)
    return filter.state


def _first_factors(model: FixModel, factors: Factors) -> list[Factors]:
    """Return factors from which the search begins: no source is too sure, one of them is, or all are."""
    options = {factors}
    each = [(group,) for group in model.estimated]
    for groups in [*each, model.estimated]:
        worse = factors
        for group in groups:
            worse = worse.with_group(group, stated=TOO_SURE)
        options.add(worse)
    return sorted(options, key=lambda one: one.stated)


def _first_labels(given: _Given, factors: Factors) -> list[Labels]:
    """Return assumptions from which the search begins: only fixes are right that agree, or all are."""
    none = np.zeros(len(given.fixes), dtype=bool)
    if not given.reckoned:
        speeds = [by * factors.motion * FASTEST * given.usual.velocity for by in (1.0, 3.0)]
        agree = [_reachable(given.steps, given.fixes, most_mps=speed) for speed in speeds]
    else:
        agree = []
        for by in (1.0, TOO_SURE):
            wider = replace(given.fixes, covariance=given.fixes.covariance * by**2)
            agree.append(_consistent(given.steps, wider, mine=~none, noise=given.usual))
            if 2 * agree[-1].sum() >= len(none):
                break
        agree = agree[-1:]
    different = {one.tobytes(): one for one in [*agree, ~none] if one.any()}
    return [Labels(~one) for one in different.values()]


def _consistent(steps: Steps, fixes: Fixes, *, mine: NDArray[np.bool_], noise: Noise) -> NDArray[np.bool_]:
    """Return which fixes (m,) have distances to at least half of their neighbours that fit the odometry.

    Distances do not depend on the heading, so that no estimate is needed. In the second round only neighbours
    that were consistent in the first are compared.
    """
    whole = replace(steps, moves=np.nan_to_num(steps.moves))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(whole.moves[1:, 0], whole.moves[1:, 1]))])
    gaps = np.cumsum(np.isnan(steps.moves[:, 0]))
    reckoned = path(whole, 0, last=len(steps) - 1)
    variance = np.trace(fixes.covariance, axis1=1, axis2=2) / 2
    found = mine.copy()
    for _ in range(2):
        places, judged = np.flatnonzero(found), found.copy()
        for i in np.flatnonzero(mine).tolist():
            at = int(np.searchsorted(places, i))
            near = places[max(0, at - NEIGHBOURS) : at + NEIGHBOURS + 1]
            near = near[(near != i) & (gaps[fixes.node[near]] == gaps[fixes.node[i]])]
            if near.size < 2:
                continue
            between = np.abs(way[fixes.node[near]] - way[fixes.node[i]])
            measured = np.hypot(*(fixes.position[near] - fixes.position[i]).T)
            driven = np.hypot(*(reckoned[fixes.node[near]] - reckoned[fixes.node[i]]).T)
            spread = np.sqrt(variance[near] + variance[i] + noise.forward**2 * between)
            agrees = np.abs(measured - driven) < 3.0 * spread + DISTANCE_TOLERANCE * between
            judged[i] = 2 * agrees.sum() >= near.size
        found = judged
    return found


def _reachable(steps: Steps, fixes: Fixes, *, most_mps: float) -> NDArray[np.bool_]:
    """Return which fixes (m,) are in the longest chain whose steps respect a limit of speed."""
    times, position = steps.times_s[fixes.node], fixes.position
    spread = np.sqrt(np.trace(fixes.covariance, axis1=1, axis2=2) / 2)
    length, before = np.ones(len(fixes), dtype=np.intp), np.full(len(fixes), -1)
    for i in range(1, len(fixes)):
        way = np.hypot(*(position[:i] - position[i]).T)
        near = way <= most_mps * (times[i] - times[:i]) + 3.0 * np.hypot(spread[:i], spread[i])
        best = int(np.argmax(np.where(near, length[:i], 0)))
        if near[best]:
            length[i], before[i] = length[best] + 1, best
    found = np.zeros(len(fixes), dtype=bool)
    at = int(np.argmax(length))
    while at >= 0:
        found[at] = True
        at = int(before[at])
    return found


def _first_of_consistent_run(
    steps: Steps, fixes: Fixes, *, gated: NDArray[np.bool_], noise: Noise
) -> int | None:
    """Return the node of the first fix of a run of wrong fixes that agree; None without one."""
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], gated, [False]]).astype(np.int8)))
    for first, last in bounds.reshape(-1, 2).tolist():
        run = np.arange(first, last)
        times = steps.times_s[fixes.node[run]]
        if len(run) < AGREEING or times[-1] - times[0] < AGREEING_S:
            continue
        few = run[np.unique(np.linspace(0, len(run) - 1, AGREEING).astype(np.intp))]
        chosen = fixes.take(few)
        alone = np.zeros(len(fixes), dtype=bool)
        alone[run] = True
        if not _consistent(steps, fixes, mine=alone, noise=noise)[run].all():
            continue
        if start(steps, chosen, begin=int(chosen.node[0]), noise=noise).agrees.all():
            return int(fixes.node[run[0]])
    return None
