"""Fuses dead reckoning with position fixes: one smoothed track, and the innovation and gating of each fix.

An extended Kalman filter with innovation gating and an RTS smoother (H. Rauch, F. Tung, C. Striebel, "Maximum
likelihood estimates of linear dynamic systems", AIAA Journal 3, 1965); see `smoother.py`.

The noise of odometry and of each source of fixes is estimated from the track itself, together with the wrong
fixes; see `outliers.py`. Robots differ: the odometry of wheels that skid in turns is several times worse than
that of rolling wheels. Receivers know their noise but not their multipath errors; many send the dilution of
precision instead of a variance; a camera may be sure of a wrong place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.missions.core.trajectory.motion import HEADING, POSITION, VELOCITY, Noise
from webapp.missions.core.trajectory.outliers import Explanation, explain, kind, scaled
from webapp.missions.core.trajectory.records import Poses, join, make_poses
from webapp.missions.core.trajectory.smoother import OutlierLabels, SmoothedTrack, smooth
from webapp.missions.core.trajectory.steps import DeadReckoning, Fixes, Floats, Steps, make_steps

DEFAULT_SIGMA_M: Mapping[str, float] = {"gps": 5.0, "visual": 5.0, "manual": 2.0}
"""Standard deviation per axis of fixes without a covariance, by their source."""

MIN_SIGMA_M = 0.02
"""Lower limit of a fix's standard deviation: a receiver that states 0 does not know it."""

MOST_POSES = 100_000
"""A longer track is sampled evenly to this number of poses; odometry keeps the whole motion between them."""

SAMPLE = 500
"""Number of poses of odometry, besides those at fixes, with which fixes are explained."""

MOST_EXPLAINED = 240
"""Largest number of fixes that are explained together; of more, a sample, and the filter gates the others."""

PAIR_S = 5.0
"""Time between the two fixes of a pair in that sample."""

BETWEEN_S, POSES_BETWEEN = 60.0, 4
"""Without odometry, fixes at most so many seconds apart get so many poses between them."""

TOO_SURE = 1.5
"""A source whose errors exceed the stated ones by this factor is reported."""

LEAST_SPEED_MPS = 0.3
"""Without odometry, the course is the heading where the speed exceeds this and its standard deviation."""


@dataclass(frozen=True, slots=True)
class SourceNoise:
    """Errors of a source, from a time on."""

    source: str  # A key of the given fixes
    since_s: float
    factor: float  # On the stated standard deviations
    correlated_s: float  # Correlation time of the errors


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """Estimated noise."""

    odometry: float  # Factor on the usual standard deviations; 1 without odometry
    sources: tuple[SourceNoise, ...]  # Ordered by source and time

    @property
    def stated(self) -> dict[str, float]:
        """Largest factor of each source."""
        return {
            one.source: max(s.factor for s in self.sources if s.source == one.source) for one in self.sources
        }

    @property
    def too_sure(self) -> list[SourceNoise]:
        """Sources with larger errors than stated, and since when."""
        return [one for one in self.sources if one.factor >= TOO_SURE]


@dataclass(frozen=True, slots=True)
class Shift:
    """Consecutive fixes of a source that were off by a common vector, and were left out."""

    source: str
    begin_s: float
    end_s: float
    fixes: int
    east_m: float  # Mean
    north_m: float


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
    gating: dict[str, GatingResult]
    # Start time of each piece: that of the track, and of each jump to another position.
    begins_s: tuple[float, ...]
    fit: NoiseFit
    shifts: tuple[Shift, ...] = ()


@dataclass(frozen=True, slots=True)
class NoFusion:
    """Nothing to fuse, and the reason. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Return False: there is no fused track."""
        return False


def fuse(
    odometry: Poses | None,
    fixes: Mapping[str, Poses],
    *,
    noise: Noise | None = None,
    check: Callable[[int], None] = lambda _: None,
) -> Fusion | NoFusion:
    """Smooth odometry and fixes, or fixes alone.

    Args:
        odometry: Only its relative motion is used, not its origin nor its covariance.
        fixes: By source: `gps`, `visual` or `manual`; of several receivers or cameras, each with a name after
            that and a space, `gps 12`. Their covariances are used where known.
        check: Called now and then with the number of nodes done; an exception that it raises cancels the
            fusion.
    """
    tracks = {source: poses for source, poses in fixes.items() if len(poses)}
    if not tracks:
        return NoFusion("no fix is available to correct a track")
    if odometry is not None and len(np.unique(odometry.times_s)) < 2:
        odometry = None  # one pose has no motion
    every = _all_fixes(tracks, most=MOST_POSES)
    frame = LocalFrame(centre_of(every.poses.latlon))
    usual = noise or Noise()
    sample = _sample(every)
    found = _explained(odometry, every.take(sample), frame=frame, usual=usual, check=check)
    steps, stated = _filter_inputs(odometry, every, frame=frame, most=MOST_POSES)
    assumed = _assumed(every, sample, found)
    measured = replace(
        stated, covariance=stated.covariance * assumed.factor[:, None, None] ** 2, share=assumed.share
    )
    noise = scaled(usual, found.factors, reckoned=odometry is not None)
    judged = OutlierLabels(assumed.weight, found.begins_s)
    done = smooth(steps, measured, noise=noise, judged=judged, check=check)
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
    fit = NoiseFit(
        1.0 if odometry is None else found.factors.motion, _source_noise(every.take(sample), found)
    )
    off = measured.position - done.state[measured.node, POSITION]
    shifts = tuple(_shift(every, off, sample[members]) for members in found.shifted)
    return Fusion(poses, gating, tuple(steps.times_s[list(done.begins)].tolist()), fit, shifts)


def _sample(every: _AllFixes) -> NDArray[np.intp]:
    """Return the indices of the fixes to explain: all, or of each source as many as of the others.

    Of too many, pairs are taken, evenly spaced; the second of a pair follows soon enough to show whether
    errors are correlated.
    """
    names, times = np.unique(every.source), every.poses.times_s
    most, chosen = MOST_EXPLAINED // len(names), []
    for name in names:
        mine = np.flatnonzero(every.source == name)
        if len(mine) > most:
            first = np.linspace(0, len(mine) - 1, max(1, most // 2)).astype(np.intp)
            second = np.searchsorted(times[mine], times[mine[first]] + PAIR_S)
            mine = mine[np.union1d(first, np.minimum(second, len(mine) - 1))]
        chosen.append(mine)
    return np.sort(np.concatenate(chosen))


def _explained(
    odometry: Poses | None,
    every: _AllFixes,
    *,
    frame: LocalFrame,
    usual: Noise,
    check: Callable[[int], None],
) -> Explanation:
    steps, fixes = _filter_inputs(odometry, every, frame=frame, most=SAMPLE)
    return explain(steps, fixes, source=every.source, usual=usual, check=check)


@dataclass(frozen=True, slots=True, eq=False)
class _Assumed:
    """What the filter assumes of each fix."""

    weight: Floats  # (m,): as in `OutlierLabels`
    factor: Floats  # (m,): on the standard deviation
    share: Floats  # (m,): as in `Fixes`


def _assumed(every: _AllFixes, sample: NDArray[np.intp], found: Explanation) -> _Assumed:
    """Extend the explanation of a sample to all fixes.

    Of n consecutive measurements with correlation rho from one to the next, n (1 - rho) / (1 + rho) count
    (M. Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series",
    Journal of the Royal Statistical Society 8, 1946).
    """
    m, times = len(every.number), every.poses.times_s
    weight, factor, share = np.full(m, np.nan), np.ones(m), np.ones(m)
    for name in np.unique(every.source):
        mine = np.flatnonzero(every.source == name)
        of_sample = np.flatnonzero(every.source[sample] == name)
        at = np.searchsorted(times[sample[of_sample]], times[mine], side="right") - 1
        group = found.group[of_sample[np.maximum(at, 0)]]
        factor[mine] = np.array(found.factors.stated)[group]
        memory_s = np.maximum(np.array(found.factors.correlated_s)[group], 1e-9)
        like = np.exp(-np.diff(times[mine], prepend=-np.inf) / memory_s)
        share[mine] = np.maximum((1 - like) / (1 + like), 1e-3)
    for members in found.shifted:
        run = sample[members]
        same = np.isin(every.source, every.source[run])
        weight[same & (times >= times[run[0]]) & (times <= times[run[-1]])] = 0.0
    weight[sample] = found.weight
    return _Assumed(weight, factor, share)


def _source_noise(every: _AllFixes, found: Explanation) -> tuple[SourceNoise, ...]:
    groups, first = np.unique(found.group, return_index=True)
    noise = [
        SourceNoise(
            str(every.source[at]),
            float(every.poses.times_s[at]),
            found.factors.stated[group],
            found.factors.correlated_s[group],
        )
        for group, at in zip(groups.tolist(), first.tolist(), strict=True)
    ]
    return tuple(sorted(noise, key=lambda one: (one.source, one.since_s)))


def _shift(every: _AllFixes, off: Floats, run: NDArray[np.intp]) -> Shift:
    times = every.poses.times_s[run]
    east, north = off[run].mean(axis=0).tolist()
    source = str(every.source[run[0]])
    return Shift(source, float(times[0]), float(times[-1]), len(run), east, north)


def _filter_inputs(
    odometry: Poses | None, every: _AllFixes, *, frame: LocalFrame, most: int
) -> tuple[Steps, Fixes]:
    """Convert odometry and fixes into steps and measurements in a local plane."""
    odometry_path = None if odometry is None else _dead_reckoning(odometry, most)
    times = every.poses.times_s
    known = _between(times, most) if odometry_path is None else odometry_path.times_s
    nodes = np.unique(np.concatenate([times, known]))
    fixes = Fixes(
        np.searchsorted(nodes, times),
        frame.enu_from_latlon(every.poses.latlon),
        _covariances(every),
        np.ones(len(times)),
    )
    return make_steps(nodes, odometry_path), fixes


def _between(times_s: Floats, most: int) -> Floats:
    """Return times between fixes: without odometry, the way from one to the next is a curve, too."""
    times = np.unique(times_s)
    near = np.diff(times) <= BETWEEN_S
    if (len(times) - 1) * POSES_BETWEEN > most:
        return times
    parts = np.linspace(times[:-1][near], times[1:][near], POSES_BETWEEN + 1, endpoint=False)
    return np.asarray(parts[1:].ravel())


@dataclass(frozen=True, slots=True, eq=False)
class _AllFixes:
    """The fixes of all sources, ordered by time: poses, source, and index in the track of that source."""

    poses: Poses
    source: NDArray[np.str_]
    number: NDArray[np.intp]

    def take(self, chosen: NDArray[np.intp]) -> _AllFixes:
        """Return some of the fixes."""
        return _AllFixes(self.poses.take(chosen), self.source[chosen], self.number[chosen])


def _in_time(poses: Poses, most: int) -> NDArray[np.intp]:
    """Return the indices of the poses in order of time; of too many, an even sample."""
    order = np.argsort(poses.times_s, kind="stable")
    count = min(len(order), most)
    return order[np.linspace(0, len(order) - 1, count).astype(np.intp)]


def _all_fixes(fixes: Mapping[str, Poses], *, most: int) -> _AllFixes:
    numbers = [_in_time(poses, most) for poses in fixes.values()]
    poses = join([p.take(n) for p, n in zip(fixes.values(), numbers, strict=True)])
    source = np.repeat(np.array(list(fixes)), [len(n) for n in numbers])
    order = np.argsort(poses.times_s, kind="stable")
    return _AllFixes(poses.take(order), source[order], np.concatenate(numbers)[order])


def _covariances(fixes: _AllFixes) -> Floats:
    """Return the covariance of each fix (m, 2, 2): its own, or that of its source."""
    east, north, both = fixes.poses.covariance_m2.T
    usual = np.array([DEFAULT_SIGMA_M[kind(source)] for source in fixes.source.tolist()]) ** 2
    stated = (east >= 0) & (north >= 0) & (both**2 <= east * north)
    found = np.empty((len(usual), 2, 2))
    found[:, 0, 0] = np.where(stated, np.maximum(east, MIN_SIGMA_M**2), usual)
    found[:, 1, 1] = np.where(stated, np.maximum(north, MIN_SIGMA_M**2), usual)
    found[:, 0, 1] = found[:, 1, 0] = np.where(stated, both, 0.0)
    return found


def _dead_reckoning(odometry: Poses, most: int) -> DeadReckoning:
    """Project odometry to a local plane of its own."""
    poses = odometry.take(_in_time(odometry, most))
    poses = poses.take(np.unique(poses.times_s, return_index=True)[1])
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
