"""How probable fixes are, given the odometry and assumptions about errors; and the most probable assumptions.

About an estimated track, all errors are jointly normal. Stacked, the residuals r of all fixes have the
covariance

    S = K0 + q^2 K1 + f_1^2 R_1 + f_2^2 R_2 + ...

K0 is the uncertainty of the start, K1 that of the odometry's usual errors, R_s the covariances that source s
states. The factors q, f_1, f_2 .. are variance components (H. Patterson and R. Thompson, "Recovery of
inter-block information when block sizes are unequal", Biometrika 58, 1971). The errors of a receiver are
correlated for some seconds, the same satellites and reflections being in view: an Ornstein-Uhlenbeck process.

A fix may be wrong: then it is anywhere within an area A. A run of fixes may be shifted: all of them by the
same unknown vector, or by one that grows steadily from none; if a shift never ends, the robot was carried.
Unknown shifts are columns C of a linear model with a uniform prior, integrated out, which gives the evidence
of all assumptions together (C. Rasmussen and C. Williams, "Gaussian Processes for Machine Learning", 2006,
section 2.7):

    -1/2 r' P r - 1/2 log|S| - 1/2 log|C' S^-1 C| + constants,   P = S^-1 - S^-1 C (C' S^-1 C)^-1 C' S^-1

The same P gives what each further assumption would add, for every run at once, from its sums over rows and
columns: with M = c' P c and g = c' P r for the columns c of a run, 1/2 g' M^-1 g - 1/2 log|M| + constants. So
outliers are identified in geodesy (W. Baarda, "A testing procedure for use in geodetic networks", 1968;
P. Teunissen, "Distributional theory for the DIA method", Journal of Geodesy 92, 2018).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from webapp.missions.core.trajectory.motion import POSITION, SIZE, SYSTEMATIC, VELOCITY, Noise, predict
from webapp.missions.core.trajectory.smoother import AGREEING, AGREEING_S
from webapp.missions.core.trajectory.steps import Fixes, Floats, Steps

OUTLIER_RADIUS_M = 100.0
"""Wrong fixes are uniform over a disc of this radius about the right place, shifts likewise."""

UNKNOWN_M = 1000.0
"""A shift that is known less well, as its fixes are those of another shift, is no assumption."""

START_M, START_RAD = 100.0, 2.0
"""Prior standard deviations of the start about the track that is given."""

WRONG_TO_GOOD = (1.0, 9.0)
"""Parameters of the beta distribution of the fraction of wrong fixes: its mean is a tenth."""

SHIFTED = 0.01
"""Prior probability of a shift at a fix; its duration is exponential..."""

USUAL_SHIFT_S = 60.0
"""... with this mean."""

MOST_SHIFT_S = 120.0
"""A shift that lasts longer is believed only if other sources contradict it."""

CARRIED = 0.003
"""Prior probability that the robot was carried before a fix."""

FACTOR_SPREAD = 2.0
"""Standard deviation of the binary logarithm of a factor: one of four is not surprising."""

LEAST_ESTIMATED = 8
"""Least number of good fixes of a source from which its factor is estimated."""

CORRELATION_S = (0.0, 5.0, 20.0)
"""Correlation times of a source's errors that are compared..."""

USUAL_CORRELATION_S = 2.5
"""... and the mean of their exponential prior distribution."""

LARGEST_FACTOR = 64.0

_ROUNDS = 60
_APART = 5
_BORDER = 1e12
_LOG_2_PI = math.log(2 * math.pi)


@dataclass(frozen=True, slots=True)
class Factors:
    """Assumed noise: factors on standard deviations, and correlation times."""

    motion: float  # On the usual errors of odometry; without odometry, on the usual velocity
    stated: tuple[float, ...]  # Of each group of fixes
    correlated_s: tuple[float, ...]  # Of each group

    def with_group(
        self, group: int, *, stated: float | None = None, correlated_s: float | None = None
    ) -> Factors:
        """Return other factors for a group."""
        factors, times = list(self.stated), list(self.correlated_s)
        factors[group] = factors[group] if stated is None else stated
        times[group] = times[group] if correlated_s is None else correlated_s
        return Factors(self.motion, tuple(factors), tuple(times))


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Fixes that are shifted together."""

    members: NDArray[np.intp]  # Ascending
    growing: bool  # The shift grows steadily from none
    carried: bool  # All later fixes are shifted: the robot was carried
    log_prior: float


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Assumptions about the fixes."""

    wrong: NDArray[np.bool_]  # (m,)
    runs: tuple[Run, ...] = ()

    def log_prior(self) -> float:
        """Return the logarithm of their prior probability."""
        m, k = len(self.wrong), int(self.wrong.sum())
        bad, good = WRONG_TO_GOOD
        mixed = math.lgamma(k + bad) + math.lgamma(m - k + good) - math.lgamma(m + bad + good)
        return mixed + sum(run.log_prior for run in self.runs)

    def determined(self) -> bool:
        """Return whether enough fixes are left to estimate each shift."""
        left = [int((~self.wrong[run.members]).sum()) for run in self.runs]
        return not self.wrong.all() and all(
            count > 1 + run.growing for count, run in zip(left, self.runs, strict=True)
        )

    def key(self) -> tuple[bytes, ...]:
        """Return what differs between labels."""
        return (self.wrong.tobytes(), *sorted(run.members.tobytes() for run in self.runs))


@dataclass(frozen=True, eq=False)
class FixModel:
    """Fixes about a track."""

    residual: Floats  # (2 m,): east and north of each fix
    start: Floats  # (2 m, 2 m): K0
    motion: Floats  # (2 m, 2 m): K1
    root: Floats  # (m, 2, 2): Cholesky factors of the stated covariances
    times_s: Floats  # (m,)
    group: NDArray[np.intp]  # (m,): fixes with the same noise
    estimated: tuple[int, ...]  # Groups whose noise is estimated
    source: NDArray[np.str_]  # (m,)
    reckoned: bool  # Whether there is odometry
    area_m2: float

    def __len__(self) -> int:
        """Count the fixes."""
        return len(self.times_s)

    @cached_property
    def alone(self) -> bool:
        """Whether all fixes are from one source."""
        return len(np.unique(self.source)) == 1

    @cached_property
    def _stated(self) -> Floats:
        return np.asarray(np.einsum("iab,jcb->iajc", self.root, self.root))

    @cached_property
    def _variances(self) -> Floats:
        return np.asarray(self.root @ self.root.transpose(0, 2, 1))

    def covariance(self, factors: Factors) -> Floats:
        """Return S, (2 m, 2 m)."""
        m, by = len(self), np.array(factors.stated)[self.group]
        found = (self.start + factors.motion**2 * self.motion).reshape(m, 2, m, 2)
        each = np.arange(m)
        found[each, :, each] += self._variances * by[:, None, None] ** 2
        for group in self.estimated:
            memory_s = factors.correlated_s[group]
            if memory_s > 0:
                mine = np.flatnonzero(self.group == group)
                times = self.times_s[mine]
                like = np.exp(-np.abs(times[:, None] - times) / memory_s) * factors.stated[group] ** 2
                np.fill_diagonal(like, 0.0)
                within = np.ix_(mine, np.arange(2), mine, np.arange(2))
                found[within] += self._stated[within] * like[:, None, :, None]
        return found.reshape(2 * m, 2 * m)


def linearised(
    steps: Steps, fixes: Fixes, *, state: Floats, piece: range, noise: Noise
) -> tuple[Floats, Floats, Floats]:
    """Return the residuals of the fixes of a piece about a track, and their covariances K0 and K1.

    Args:
        fixes: Those of the piece.
        state: (n, 8) float64. The track.
    """
    m = len(fixes)
    still = Noise(**dict.fromkeys(_MOVING, 0.0), resting_m=noise.resting_m, resting_rad=noise.resting_rad)
    moving = replace(noise, resting_m=0.0, resting_rad=0.0)
    parts = np.zeros((2, SIZE, SIZE))
    parts[0] = np.diag([START_M**2, START_M**2, 0, 0, START_RAD**2, 0, 0, 0])
    spread = np.array([noise.scale, noise.turn_scale, noise.curve])
    parts[1] = np.diag([0, 0, noise.velocity**2, noise.velocity**2, 0, *spread**2])
    mean = np.zeros(SIZE)
    mean[VELOCITY], mean[SYSTEMATIC] = -state[piece.start, VELOCITY], -state[piece.start, SYSTEMATIC]
    cross = np.zeros((2, 2 * m, SIZE))  # covariance of each fix so far with the state
    between, residual, done = np.zeros((2, 2 * m, 2 * m)), np.zeros(2 * m), 0
    for node in piece:
        if node > piece.start:
            move, before = steps.moves[node], state[node - 1]
            seconds = float(steps.times_s[node] - steps.times_s[node - 1])
            after, change, added = predict(before, move, seconds=seconds, noise=moving)
            rest = predict(before, move, seconds=seconds, noise=still)[2]
            mean = change @ mean + after - state[node]
            parts = change @ parts @ change.T + np.stack([rest, added])
            cross[:, : 2 * done] = cross[:, : 2 * done] @ change.T
        while done < m and fixes.node[done] == node:
            here = slice(2 * done, 2 * done + 2)
            cross[:, here] = parts[:, POSITION]
            residual[here] = fixes.position[done] - state[node, POSITION] - mean[POSITION]
            upto = slice(0, 2 * done + 2)
            between[:, upto, here] = cross[:, upto, POSITION]
            between[:, here, upto] = between[:, upto, here].transpose(0, 2, 1)
            done += 1
    return residual, between[0], between[1]


_MOVING = ("forward", "sideways", "heading", "turning", "scale", "turn_scale", "curve", "velocity")


def log_evidence(
    model: FixModel, labels: Labels, *, factors: Factors, covariance: Floats | None = None
) -> float:
    """Return the logarithm of the evidence of the assumptions."""
    covariance = model.covariance(factors) if covariance is None else covariance
    return _solve(model, labels, covariance).log_evidence + _log_prior(model, factors)


def _log_prior(model: FixModel, factors: Factors) -> float:
    every = [factors.motion, *(factors.stated[group] for group in model.estimated)]
    memory_s = sum(factors.correlated_s[group] for group in model.estimated)
    # without odometry, motion and errors are hard to distinguish
    spread = FACTOR_SPREAD if model.reckoned else FACTOR_SPREAD / 2
    return -sum((math.log2(one) / spread) ** 2 for one in every) / 2 - memory_s / USUAL_CORRELATION_S


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The linear model under some assumptions."""

    rows: NDArray[np.intp]  # Of the fixes that are not wrong
    covariance: Floats  # Theirs
    columns: Floats  # (2 m, c): C
    uncertain: Floats  # (c, c): inverse of C' S^-1 C
    shift: Floats  # (c,): estimated shifts
    log_evidence: float


def _solve(model: FixModel, labels: Labels, covariance: Floats) -> _Solved:
    rows = np.flatnonzero(np.repeat(~labels.wrong, 2))
    n, used = len(rows), covariance[np.ix_(rows, rows)]
    columns = _columns(model, labels.runs)
    # one Cholesky factorisation, of S bordered by r and C, gives log|S| and L^-1 (r, C)
    border = np.column_stack([model.residual[rows], columns[rows]])
    lower = np.linalg.cholesky(np.block([[used, border], [border.T, np.eye(border.shape[1]) * _BORDER]]))
    white = lower[n:, :n].T
    r, c = white[:, 0], white[:, 1:]
    information = c.T @ c
    if columns.shape[1] and np.linalg.eigvalsh(information)[0] < 1 / UNKNOWN_M**2:
        return _Solved(rows, used, columns, information, np.zeros(columns.shape[1]), -math.inf)
    uncertain = np.linalg.inv(information)
    shift = uncertain @ (c.T @ r)
    left = r - c @ shift
    anywhere = int(labels.wrong.sum()) + columns.shape[1] / 2
    found = (
        -(left @ left) / 2
        - float(np.log(np.diag(lower)[:n]).sum())
        - float(np.linalg.slogdet(information)[1]) / 2
        - (n - columns.shape[1]) / 2 * _LOG_2_PI
        - anywhere * math.log(model.area_m2)
        + labels.log_prior()
    )
    return _Solved(rows, used, columns, uncertain, shift, float(found))


def _columns(model: FixModel, runs: tuple[Run, ...]) -> Floats:
    """Return C (2 m, c)."""
    found = np.zeros((len(model), 2, 0))
    for run in runs:
        shape = np.ones(len(run.members))
        if run.growing:
            times = model.times_s[run.members]
            shape = (times - _none_s(times)) / (times[-1] - _none_s(times))
        column = np.zeros((len(model), 2, 2))
        column[run.members] = shape[:, None, None] * np.eye(2)
        found = np.concatenate([found, column], axis=2)
    return found.reshape(2 * len(model), -1)


def _none_s(times_s: Floats) -> float:
    """Return when a growing shift was none: as long before its first fix as the fixes are apart."""
    return float(times_s[0] - (times_s[-1] - times_s[0]) / (len(times_s) - 1))


def search(model: FixModel, labels: Labels, *, factors: Factors) -> tuple[Labels, float]:
    """Change assumptions about fixes and runs one after the other while the evidence grows."""
    covariance = model.covariance(factors)
    solved = _solve(model, labels, covariance)
    for _ in range(_ROUNDS):
        known = _inverse(model, solved)
        gain = _of_fixes(model, labels, solved, covariance=covariance, known=known)
        best = int(np.argmax(gain))
        options = [_flipped(model, labels, gain), _with(labels, wrong=best)]
        run, run_gain = _best_run(model, labels, known)
        if run is not None and run_gain > gain[best]:
            options = [replace(labels, runs=(*labels.runs, run))]
        options += [
            replace(labels, runs=tuple(r for r in labels.runs if r is not one)) for one in labels.runs
        ]
        joined = _joined(model, labels)
        better = _better(model, options, solved=solved, covariance=covariance) or _better(
            model, joined, solved=solved, covariance=covariance
        )
        if better is None:
            break
        labels, solved = better
    return labels, solved.log_evidence + _log_prior(model, factors)


def _better(
    model: FixModel, options: list[Labels], *, solved: _Solved, covariance: Floats
) -> tuple[Labels, _Solved] | None:
    """Return the best of some assumptions if it is better than before."""
    tried = [(one, _solve(model, one, covariance)) for one in options if one.determined()]
    best = max(tried, key=lambda pair: pair[1].log_evidence, default=None)
    return None if best is None or best[1].log_evidence <= solved.log_evidence + 1e-6 else best


def _joined(model: FixModel, labels: Labels) -> list[Labels]:
    """Return assumptions in which consecutive wrong fixes of a source are shifted together."""
    options: list[Labels] = []
    if not model.reckoned:
        return options
    for name in np.unique(model.source):
        mine = np.flatnonzero(model.source == name)
        wrong = labels.wrong[mine].astype(np.int8)
        bounds = np.flatnonzero(np.diff(np.concatenate([[0], wrong, [0]])))
        for first, last in bounds.reshape(-1, 2).tolist():
            members = mine[first:last]
            seconds = float(np.ptp(model.times_s[members]))
            if len(members) < 2 or any(np.isin(members, run.members).any() for run in labels.runs):
                continue
            if seconds > MOST_SHIFT_S and model.alone:
                continue
            right = labels.wrong.copy()
            right[members] = False
            run = Run(members, False, False, _shift_log_prior(seconds))
            options.append(Labels(right, (*labels.runs, run)))
    return options


def _shift_log_prior(seconds: float) -> float:
    return math.log(SHIFTED) - min(seconds, MOST_SHIFT_S) / USUAL_SHIFT_S


def _with(labels: Labels, *, wrong: int) -> Labels:
    flipped = labels.wrong.copy()
    flipped[wrong] = ~flipped[wrong]
    return replace(labels, wrong=flipped)


def _flipped(model: FixModel, labels: Labels, gain: Floats) -> Labels:
    """Change the fixes that gain most, none near another."""
    wrong, free = labels.wrong.copy(), np.ones(len(model), dtype=bool)
    for at in np.argsort(-gain).tolist():
        if gain[at] <= 0:
            break
        if free[at]:
            wrong[at] = ~wrong[at]
            free[max(0, at - _APART) : at + _APART + 1] = False
    return replace(labels, wrong=wrong)


@dataclass(frozen=True, slots=True, eq=False)
class _Inverse:
    """What the gains of further assumptions are computed from."""

    inverse: Floats  # Of the covariance of the fixes that are not wrong
    precision: Floats  # (m, 2, m, 2): P; zero for wrong fixes
    pull: Floats  # (m, 2): P r


def _inverse(model: FixModel, solved: _Solved) -> _Inverse:
    m, rows = len(model), solved.rows
    inverse = np.asarray(np.linalg.inv(solved.covariance), dtype=np.float64)
    bent = inverse @ solved.columns[rows]
    found = np.zeros((2 * m, 2 * m))
    found[np.ix_(rows, rows)] = inverse - bent @ solved.uncertain @ bent.T
    return _Inverse(inverse, found.reshape(m, 2, m, 2), (found @ model.residual).reshape(m, 2))


def _of_fixes(
    model: FixModel, labels: Labels, solved: _Solved, *, covariance: Floats, known: _Inverse
) -> Floats:
    """Return what the log-evidence would gain (m,) by changing whether each fix is wrong."""
    m, wrong = len(model), labels.wrong
    bad, good = WRONG_TO_GOOD
    k = int(wrong.sum())
    found = np.empty(m)
    used, left = np.flatnonzero(~wrong), np.flatnonzero(wrong)
    constant = _LOG_2_PI - math.log(model.area_m2)
    block = known.precision[used, :, used]
    found[used] = _gain(block, known.pull[used]) + constant + math.log((k + bad) / (m - k - 1 + good))
    if left.size:
        density = _predicted(model, solved, left, covariance=covariance, known=known)
        found[left] = density + math.log(model.area_m2) - math.log((k - 1 + bad) / (m - k + good))
    return found


def _predicted(
    model: FixModel, solved: _Solved, left: NDArray[np.intp], *, covariance: Floats, known: _Inverse
) -> Floats:
    """Return the log-density of wrong fixes (k,) if they were right, given the others."""
    m, rows = len(model), (2 * left[:, None] + np.arange(2)).ravel()
    across = covariance[np.ix_(rows, solved.rows)]
    weights = across @ known.inverse
    bent = solved.columns[rows] - weights @ solved.columns[solved.rows]
    expected = weights @ model.residual[solved.rows] + bent @ solved.shift
    off = (model.residual[rows] - expected).reshape(-1, 2)
    pairs = (len(left), 2, -1)
    around = covariance.reshape(m, 2, m, 2)[left, :, left]
    around = around - np.einsum("iax,ibx->iab", weights.reshape(pairs), across.reshape(pairs))
    bents = bent.reshape(len(left), 2, bent.shape[1])
    around = around + np.einsum("iac,cd,ibd->iab", bents, solved.uncertain, bents)
    distance = np.einsum("mi,mi->m", off, np.linalg.solve(around, off[:, :, None])[:, :, 0])
    sign, logarithm = np.linalg.slogdet(around)
    return np.where(sign > 0, -distance / 2 - logarithm / 2 - _LOG_2_PI, -math.inf)


def _gain(information: Floats, pull: Floats) -> Floats:
    """Return 1/2 g' M^-1 g - 1/2 log|M|, of many (k, d, d) and (k, d)."""
    solved = np.linalg.solve(information, pull[:, :, None])[:, :, 0]
    return np.asarray((np.einsum("kd,kd->k", pull, solved) - np.linalg.slogdet(information)[1]) / 2)


def _best_run(model: FixModel, labels: Labels, known: _Inverse) -> tuple[Run | None, float]:
    """Return the run whose shift would add most to the log-evidence, and how much."""
    best: tuple[Run | None, float] = (None, 0.0)
    if not model.reckoned:
        return best
    every = np.arange(len(model))
    names = np.unique(model.source)
    options = [(every[model.source == name], False) for name in names]
    for members, carried in [*options, (every, True)]:
        found = _best_of(model, labels, known, members=members, carried=carried)
        best = max(best, found, key=lambda pair: pair[1])
    return best


def _best_of(
    model: FixModel,
    labels: Labels,
    known: _Inverse,
    *,
    members: NDArray[np.intp],
    carried: bool,
) -> tuple[Run | None, float]:
    """Return the best run among some fixes: from one to another, or if `carried`, to the last."""
    k = len(members)
    times = model.times_s[members]
    used = np.concatenate([[0], np.cumsum(~labels.wrong[members])])
    runs = [run.members for run in labels.runs if run.carried == carried]
    taken = np.isin(members, np.concatenate(runs)) if runs else np.zeros(k, dtype=bool)
    taken_before = np.concatenate([[0], np.cumsum(taken)])
    first, last = np.triu_indices(k + 1, 2)
    seconds = times[last - 1] - times[first]
    count = used[last] - used[first]
    if carried:
        good = (last == k) & (count >= AGREEING) & (used[first] >= AGREEING) & (seconds >= AGREEING_S)
        good &= ~np.isin(members[first], [run.members[0] for run in labels.runs])
    else:
        good = (count >= 2) & (taken_before[last] == taken_before[first])
        if model.alone:
            good &= (seconds <= MOST_SHIFT_S) & (3 * count <= used[-1])
    first, last, seconds, count = first[good], last[good], seconds[good], count[good]
    if not len(first):
        return None, 0.0
    since = (times - times[0]) / 60.0
    block = known.precision[members][:, :, members].transpose(0, 2, 1, 3)
    sums = [_summed(block * by[:, :, None, None]) for by in _powers(since)]
    inside = [s[last, last] - s[first, last] - s[last, first] + s[first, first] for s in sums]
    pull = known.pull[members]
    pulls = [np.concatenate([np.zeros((1, 2)), np.cumsum(p, axis=0)]) for p in (pull, pull * since[:, None])]
    pulled = [p[last] - p[first] for p in pulls]
    prior = np.full(len(first), math.log(CARRIED))
    if not carried:
        prior = np.array([_shift_log_prior(one) for one in seconds.tolist()])
    constant = _LOG_2_PI - math.log(model.area_m2)
    gain = _gain(inside[0], pulled[0]) + constant + prior
    at = int(np.argmax(gain))
    best = (Run(members[first[at] : last[at]], False, carried, float(prior[at])), float(gain[at]))
    some = np.flatnonzero((count >= 3) & (seconds > 0))
    if carried or not some.size:
        return best
    length = seconds[some] / 60.0
    gap = length / (last[some] - first[some] - 1)
    none, grown = (since[first[some]] - gap)[:, None], (length + gap)[:, None]
    zero, one, two = (matrix[some] for matrix in inside)
    n, g = none[:, :, None], grown[:, :, None]
    information = (two - n * (one + one.transpose(0, 2, 1)) + n**2 * zero) / g**2
    gain = _gain(information, (pulled[1][some] - none * pulled[0][some]) / grown) + constant + prior[some]
    at = int(np.argmax(gain))
    if gain[at] <= best[1]:
        return best
    chosen = some[at]
    return Run(members[first[chosen] : last[chosen]], True, False, float(prior[chosen])), float(gain[at])


def _powers(since: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the weights of pairs for the sums over 1, t and t t'."""
    ones = np.ones_like(since)
    return np.outer(ones, ones), np.outer(since, ones), np.outer(since, since)


def _summed(block: Floats) -> Floats:
    """Return the sums over all earlier rows and columns, (k + 1, k + 1, 2, 2)."""
    k = len(block)
    found = np.zeros((k + 1, k + 1, 2, 2))
    found[1:, 1:] = block.cumsum(axis=0).cumsum(axis=1)
    return found


def refine(
    model: FixModel, labels: Labels, *, factors: Factors, ratios: tuple[float, ...] = (2.0, 2**0.5, 2**0.25)
) -> tuple[Factors, float]:
    """Change the factors while the evidence grows, by smaller and smaller ratios."""
    best = log_evidence(model, labels, factors=factors)
    counts = np.bincount(model.group[~labels.wrong], minlength=len(factors.stated))
    groups = [group for group in model.estimated if counts[group] >= LEAST_ESTIMATED]
    for ratio in ratios:
        last = -math.inf
        while best > last + 1e-3:
            last = best
            for change in _changes(groups, ratio):
                while (option := change(factors)) != factors:
                    value = log_evidence(model, labels, factors=option)
                    if value <= best + 1e-3:
                        break
                    factors, best = option, value
    return factors, best


def _changes(groups: list[int], ratio: float) -> list[Callable[[Factors], Factors]]:
    """Return the changes of factors that are tried in turn."""

    def motion(by: float) -> Callable[[Factors], Factors]:
        return lambda f: replace(f, motion=min(LARGEST_FACTOR, max(1 / LARGEST_FACTOR, f.motion * by)))

    def stated(group: int, by: float) -> Callable[[Factors], Factors]:
        return lambda f: f.with_group(group, stated=min(LARGEST_FACTOR, max(1.0, f.stated[group] * by)))

    def correlated(group: int, seconds: float) -> Callable[[Factors], Factors]:
        return lambda f: f.with_group(group, correlated_s=seconds)

    found = [motion(ratio), motion(1 / ratio)]
    for group in groups:
        found += [stated(group, ratio), stated(group, 1 / ratio)]
        found += [correlated(group, seconds) for seconds in CORRELATION_S]
    return found


def distances(model: FixModel, labels: Labels, *, factors: Factors) -> Floats:
    """Return the squared Mahalanobis distance (m,) of each fix from what all others predict; NaN if wrong."""
    known = _inverse(model, _solve(model, labels, model.covariance(factors)))
    used = np.flatnonzero(~labels.wrong)
    pull, block = known.pull[used], known.precision[used, :, used]
    found = np.full(len(model), np.nan)
    found[used] = np.einsum("mi,mi->m", pull, np.linalg.solve(block, pull[:, :, None])[:, :, 0])
    return found
