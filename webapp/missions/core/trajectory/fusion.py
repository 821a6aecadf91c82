"""Fuses dead reckoning with position fixes: one smoothed track, and the innovation and gating of each fix.

An extended Kalman filter with innovation gating and an RTS smoother (H. Rauch, F. Tung, C. Striebel, "Maximum
likelihood estimates of linear dynamic systems", AIAA Journal 3, 1965); see `smoother.py`.

The noise of odometry and of each source of fixes is estimated from the track itself. Robots differ: the
odometry of wheels that skid in turns is several times worse than that of rolling wheels. Receivers know their
noise but not their multipath errors; many send the dilution of precision instead of a variance; a camera may
be sure of a wrong place. So each fix is predicted from the ones before under several assumptions, and the one
under which the fixes are most likely is chosen (F. Schweppe, "Evaluation of likelihood functions for Gaussian
signals", IEEE Transactions on Information Theory 11, 1965). All sources are estimated together: one that
states too little would otherwise make the others look noisy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.missions.core.trajectory.motion import HEADING, POSITION, VELOCITY, Noise
from webapp.missions.core.trajectory.outliers import LEADING, find_outliers
from webapp.missions.core.trajectory.records import Poses, Source, join, make_poses
from webapp.missions.core.trajectory.smoother import OutlierLabels, SmoothedTrack, log_likelihood, smooth
from webapp.missions.core.trajectory.steps import DeadReckoning, Fixes, Floats, Steps, make_steps

_ODOMETRY = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors on the usual errors of odometry."""

_STATED: Mapping[Source, tuple[float, ...]] = {"gps": (1.0, 2.0, 4.0), "visual": (1.0, 2.0, 4.0, 8.0)}
"""Factors on the stated standard deviations of a source: none below 1, as none is better than it states.

Positions set by hand are believed."""

_MOTION = (1 / 8, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Factors on the usual velocity, for a track without odometry."""

_FIRST = (1.0, 2.0)
"""Factors on the odometry under which several sources are compared, before its own factor is refined."""

DEFAULT_SIGMA_M: Mapping[Source, float] = {"gps": 5.0, "visual": 5.0, "manual": 2.0}
"""Standard deviation per axis of fixes without a covariance, by their source."""

MIN_SIGMA_M = 0.02
"""Lower limit of a fix's standard deviation: a receiver that states 0 does not know it."""

MOST_POSES = 100_000
"""A longer track is sampled evenly to this number of poses; odometry keeps the whole motion between them."""

SAMPLE = 500
"""Fixes per source from which the noise is estimated, with four times as many poses of odometry."""

MOST_JUDGED = 2000
"""Largest number of fixes that are judged by the whole track."""

WORSE = 2.0
"""Factor on the usual errors of odometry while outliers are searched before its noise is known."""

LEAST_SAMPLE = 8
"""Least number of fixes from which the noise is estimated."""

CORRELATION_TIME_S = 20.0
"""Correlation time of a receiver's errors, from the same satellites and reflections: fixes within it count as
one measurement."""

LEAST_SPEED_MPS = 0.3
"""Without odometry, the course is the heading where the speed exceeds this and its standard deviation."""


@dataclass(frozen=True, slots=True)
class _NoiseFit:
    """Factors on the assumed standard deviations."""

    odometry: float = 1.0
    stated: Mapping[Source, float] = field(default_factory=dict)  # By source; 1 where it is missing
    motion: float = 1.0  # On the velocity, of a track without odometry

    def noise(self, usual: Noise) -> Noise:
        """Return the scaled noise of the odometry."""
        by = self.odometry
        return replace(
            usual,
            forward=usual.forward * by,
            sideways=usual.sideways * by,
            heading=usual.heading * by,
            turning=usual.turning * by,
            scale=usual.scale * by,
            turn_scale=usual.turn_scale * by,
            curve=usual.curve * by,
            velocity=usual.velocity * self.motion,
        )

    def fixes(self, stated: Fixes, *, source: NDArray[np.str_]) -> Fixes:
        """Return the fixes with scaled covariances.

        Args:
            source: (m,) str. Where each came from.
        """
        by = np.ones(len(stated))
        for name, factor in self.stated.items():
            by[source == name] = factor**2
        return replace(stated, covariance=stated.covariance * by[:, None, None])


def _fit_noise(
    steps: Steps,
    fixes: Fixes,
    *,
    source: NDArray[np.str_],
    usual: Noise,
    judged: Callable[[Fixes, _NoiseFit], OutlierLabels | None] = lambda *_: None,
) -> _NoiseFit:
    """Estimate the noise of the odometry and of each source of fixes.

    Args:
        steps, fixes: A sample of the track is enough: it is filtered once for each assumption.
        source: (m,) str. Where each fix came from.
        judged: Finds outliers under assumed covariances and motion, as they are no evidence of a noisy
            source. The judgement is used if it makes the fixes likelier.
    """
    present = [name for name in _STATED if (source == name).any()]
    stated = [dict(zip(present, by, strict=True)) for by in product(*(_STATED[name] for name in present))]
    scaled = [_NoiseFit(stated=one).fixes(fixes, source=source) for one in stated]
    reckoned = bool(np.isfinite(steps.moves).any())
    judgements: dict[tuple[float, int], OutlierLabels | None] = {}

    def likelihood(by: float, which: int) -> float:
        assumed = _NoiseFit(by) if reckoned else _NoiseFit(motion=by)
        at = (1.0 if reckoned else by, which)
        if at not in judgements:
            judgements[at] = judged(scaled[which], _NoiseFit(motion=at[0]))
        return max(
            log_likelihood(steps, scaled[which], noise=assumed.noise(usual), judged=judgement)
            for judgement in (None, judgements[at])
        )

    every = _ODOMETRY if reckoned else _MOTION
    first = every if len(present) < 2 or not reckoned else [one for one in every if one in _FIRST]
    found = {pair: likelihood(*pair) for pair in product(first, range(len(stated)))}
    best = max(found, key=lambda pair: found[pair])[1]
    found |= {(by, best): likelihood(by, best) for by in every if (by, best) not in found}
    by, which = max(found, key=lambda pair: found[pair])
    return _NoiseFit(by, stated[which]) if reckoned else _NoiseFit(1.0, stated[which], by)


@dataclass(frozen=True, slots=True, eq=False)
class GatingResult:
    """Innovations of the fixes of one track, and which fixes the filter rejected."""

    number: NDArray[np.intp]  # (m,) intp. Indices in the given track, ordered by time.
    # (m,) float64. Squared Mahalanobis distance of the innovation; its mean is 2 where all covariances are
    # right.
    distance: Floats
    gated: NDArray[np.bool_]  # (m,) bool. Whether each was rejected as an outlier.
    expected: Floats  # (m, 2) float64. Predicted positions, degrees north and east.
    innovation_m: Floats  # (m,) float64. Length of the innovation, metres.

    @property
    def mean_distance(self) -> float:
        """Mean over the fixes that were used; NaN without any."""
        used = self.distance[~self.gated]
        return float(used.mean()) if used.size else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A fused track."""

    poses: Poses  # At each time of the odometry and of the fixes
    gating: dict[Source, GatingResult]
    # Start time of each piece: that of the track, and of each jump to another position.
    begins_s: tuple[float, ...]
    fit: _NoiseFit  # Factors on the noise of odometry and sources, estimated from this track


@dataclass(frozen=True, slots=True)
class NoFusion:
    """Nothing to fuse, and the reason. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Return False: there is no fused track."""
        return False


def fuse(
    odometry: Poses | None,
    fixes: Mapping[Source, Poses],
    *,
    noise: Noise | None = None,
    check: Callable[[int], None] = lambda _: None,
) -> Fusion | NoFusion:
    """Smooth odometry and fixes, or fixes alone.

    Args:
        odometry: Only its relative motion is used, not its origin nor its covariance.
        fixes: Their covariances are used where known.
        check: Called now and then with the number of nodes done; an exception that it raises cancels the
            fusion.
    """
    tracks = {source: poses for source, poses in fixes.items() if len(poses)}
    if not tracks:
        return NoFusion("no fix is available to correct a track")
    every = _all_fixes(tracks, most=MOST_POSES)
    frame = LocalFrame(centre_of(every.poses.latlon))
    usual = noise or Noise()
    found = _fit(odometry, tracks, frame=frame, usual=usual, check=check)
    steps, stated = _filter_inputs(odometry, every, frame=frame, most=MOST_POSES)
    measured = found.fixes(stated, source=every.source)
    judged = _judged(odometry, every, found, frame=frame, usual=usual, check=check)
    done = smooth(steps, measured, noise=found.noise(usual), judged=judged, check=check)
    poses = _poses(steps, done, frame=frame, height_m=_heights(every, steps.times_s, done.gated))
    expected = frame.latlon_from_enu(done.expected)
    innovation_m = np.hypot(*(measured.position - done.expected).T)
    gating = {
        source: GatingResult(
            every.number[mine], done.distance[mine], done.gated[mine], expected[mine], innovation_m[mine]
        )
        for source in tracks
        for mine in [every.source == source]
    }
    return Fusion(poses, gating, tuple(steps.times_s[list(done.begins)].tolist()), found)


def _fit(
    odometry: Poses | None,
    tracks: Mapping[Source, Poses],
    *,
    frame: LocalFrame,
    usual: Noise,
    check: Callable[[int], None],
) -> _NoiseFit:
    """Estimate the noise of odometry and sources, from fixes with independent errors."""
    apart = {source: _decorrelated(poses) if source == "gps" else poses for source, poses in tracks.items()}
    sample = _all_fixes(apart, most=SAMPLE)
    if len(sample.number) < LEAST_SAMPLE:
        return _NoiseFit()
    steps, fixes = _filter_inputs(odometry, sample, frame=frame, most=4 * SAMPLE)
    coarse, _ = _filter_inputs(odometry, sample, frame=frame, most=SAMPLE)
    nodes = np.searchsorted(coarse.times_s, sample.poses.times_s)

    def judged(assumed: Fixes, found: _NoiseFit) -> OutlierLabels | None:
        worse = replace(found, odometry=WORSE).noise(usual)
        return find_outliers(coarse, replace(assumed, node=nodes), noise=worse, check=check)

    return _fit_noise(steps, fixes, source=sample.source, usual=usual, judged=judged)


def _judged(
    odometry: Poses | None,
    every: _AllFixes,
    found: _NoiseFit,
    *,
    frame: LocalFrame,
    usual: Noise,
    check: Callable[[int], None],
) -> OutlierLabels | None:
    """Judge the fixes by the whole track; of too many, a sample, and the filter judges the others.

    None where the filter alone explains the fixes better, for instance if odometry drift bends the path.
    """
    chosen = np.linspace(0, len(every.number) - 1, min(len(every.number), MOST_JUDGED)).astype(np.intp)
    some = _AllFixes(every.poses.take(chosen), every.source[chosen], every.number[chosen])
    steps, stated = _filter_inputs(odometry, some, frame=frame, most=SAMPLE)
    measured = found.fixes(stated, source=some.source)
    noise = found.noise(usual)
    judged = find_outliers(steps, measured, noise=noise, leading=LEADING, check=check)
    by_itself = log_likelihood(steps, measured, noise=noise)
    if judged is None or log_likelihood(steps, measured, noise=noise, judged=judged) < by_itself:
        return None
    weight = np.full(len(every.number), np.nan)
    weight[chosen] = judged.weight
    return OutlierLabels(weight, judged.begins_s)


def _decorrelated(poses: Poses) -> Poses:
    """Return one fix per correlation time, so that their errors are independent."""
    order = np.argsort(poses.times_s, kind="stable")
    turn = np.floor((poses.times_s[order] - poses.times_s[order[0]]) / CORRELATION_TIME_S)
    return poses.take(order[np.unique(turn, return_index=True)[1]])


def _filter_inputs(
    odometry: Poses | None, every: _AllFixes, *, frame: LocalFrame, most: int
) -> tuple[Steps, Fixes]:
    """Convert odometry and fixes into steps and measurements in a local plane."""
    odometry_path = None if odometry is None else _dead_reckoning(odometry, most)
    times = every.poses.times_s
    nodes = np.unique(times if odometry_path is None else np.concatenate([times, odometry_path.times_s]))
    fixes = Fixes(
        np.searchsorted(nodes, times),
        frame.enu_from_latlon(every.poses.latlon),
        _covariances(every),
        _shares(every),
    )
    return make_steps(nodes, odometry_path), fixes


@dataclass(frozen=True, slots=True, eq=False)
class _AllFixes:
    """The fixes of all sources, ordered by time: poses, source, and index in the track of that source."""

    poses: Poses
    source: NDArray[np.str_]
    number: NDArray[np.intp]


def _in_time(poses: Poses, most: int) -> NDArray[np.intp]:
    """Return the indices of the poses in order of time; of too many, an even sample."""
    order = np.argsort(poses.times_s, kind="stable")
    count = min(len(order), most)
    return order[np.linspace(0, len(order) - 1, count).astype(np.intp)]


def _all_fixes(fixes: Mapping[Source, Poses], *, most: int) -> _AllFixes:
    numbers = [_in_time(poses, most) for poses in fixes.values()]
    poses = join([p.take(n) for p, n in zip(fixes.values(), numbers, strict=True)])
    source = np.repeat(np.array(list(fixes)), [len(n) for n in numbers])
    order = np.argsort(poses.times_s, kind="stable")
    return _AllFixes(poses.take(order), source[order], np.concatenate(numbers)[order])


def _covariances(fixes: _AllFixes) -> Floats:
    """Return the covariance of each fix (m, 2, 2): its own, or that of its source."""
    east, north, both = fixes.poses.covariance_m2.T
    usual = np.array([DEFAULT_SIGMA_M[source] for source in fixes.source.tolist()]) ** 2
    stated = (east >= 0) & (north >= 0) & (both**2 <= east * north)
    found = np.empty((len(usual), 2, 2))
    found[:, 0, 0] = np.where(stated, np.maximum(east, MIN_SIGMA_M**2), usual)
    found[:, 1, 1] = np.where(stated, np.maximum(north, MIN_SIGMA_M**2), usual)
    found[:, 0, 1] = found[:, 1, 0] = np.where(stated, both, 0.0)
    return found


def _shares(fixes: _AllFixes) -> Floats:
    """Weight each fix as a fraction of an independent measurement, by the time since the previous one."""
    found = np.ones(len(fixes.source))
    of_gps = fixes.source == "gps"
    waited = np.diff(fixes.poses.times_s[of_gps], prepend=-np.inf)
    found[of_gps] = np.clip(waited / CORRELATION_TIME_S, 1e-3, 1.0)
    return found


def _dead_reckoning(odometry: Poses, most: int) -> DeadReckoning | None:
    """Project odometry to a local plane of its own; None for fewer than two poses."""
    poses = odometry.take(_in_time(odometry, most))
    poses = poses.take(np.unique(poses.times_s, return_index=True)[1])
    if len(poses) < 2:
        return None
    position = LocalFrame(centre_of(poses.latlon)).enu_from_latlon(poses.latlon)
    return DeadReckoning(poses.times_s, position, _headings(np.radians(poses.heading_deg), position))


def _headings(stated: Floats, position: Floats) -> Floats:
    """Return unwrapped headings: those of the poses if most have one, else the course to the next pose."""
    known = np.flatnonzero(np.isfinite(stated))
    if 2 * known.size >= len(stated):
        return np.interp(np.arange(len(stated)), known, np.unwrap(stated[known]))
    moves = np.diff(position, axis=0)
    known = np.flatnonzero(np.hypot(*moves.T) > 0)
    if not known.size:
        return np.zeros(len(stated))
    at = np.clip(np.searchsorted(known, np.arange(len(stated))), 0, known.size - 1)
    return np.unwrap(np.arctan2(moves[:, 0], moves[:, 1])[known])[at]


def _heights(fixes: _AllFixes, nodes: Floats, gated: NDArray[np.bool_]) -> Floats:
    """Interpolate the height of each node between accepted fixes; NaN where none has one."""
    known = ~gated & np.isfinite(fixes.poses.height_m)
    if not known.any():
        return np.full(len(nodes), np.nan)
    return np.interp(nodes, fixes.poses.times_s[known], fixes.poses.height_m[known])


def _poses(steps: Steps, done: SmoothedTrack, *, frame: LocalFrame, height_m: Floats) -> Poses:
    reckoned = np.isfinite(steps.moves[:, 0])
    reckoned[:-1] |= reckoned[1:]
    state, covariance = done.state, done.covariance
    speed = np.hypot(*state[:, VELOCITY].T)
    spread = np.sqrt(np.trace(covariance[:, VELOCITY, VELOCITY], axis1=1, axis2=2))
    course = np.where(
        speed > np.maximum(spread, LEAST_SPEED_MPS), np.arctan2(state[:, 2], state[:, 3]), np.nan
    )
    way = np.hypot(*np.diff(state[:, POSITION], axis=0).T)
    way[[begin - 1 for begin in done.begins[1:]]] = 0.0  # a jump between pieces is no distance travelled
    return make_poses(
        steps.times_s,
        frame.latlon_from_enu(state[:, POSITION]),
        height_m=height_m,
        heading_deg=np.degrees(np.where(reckoned, state[:, HEADING], course)),
        covariance_m2=covariance[:, [0, 1, 0], [0, 1, 1]],
        travelled_m=np.concatenate([[0.0], np.cumsum(way)]),
    )
