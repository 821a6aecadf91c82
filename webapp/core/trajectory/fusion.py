"""Dead reckoning put together with fixes: one corrected track, and what was thought of each fix."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.trajectory.motion import HEADING, POSITION, VELOCITY, Noise
from webapp.core.trajectory.noise_fit import Fit, fit
from webapp.core.trajectory.records import Poses, Source, join, make_poses
from webapp.core.trajectory.smoother import Smoothed, smooth
from webapp.core.trajectory.steps import Fixes, Floats, Reckoning, Steps, make_steps

UNTOLD_M: Mapping[Source, float] = {"gps": 5.0, "visual": 5.0, "manual": 2.0}
"""Standard deviation to the east and to the north of fixes that do not tell theirs, by their source."""

LEAST_M = 0.02
"""No fix is believed to be better: a receiver that says 0 does not know."""

MOST_POSES = 100_000
"""Of a longer track so many are taken, evenly: of odometry, the movement between them is kept whole."""

SAMPLE = 500
"""Of so many fixes of each source, and four times as much odometry, it is found how wrong they are."""

LEAST_SAMPLE = 8
"""Fewer fixes tell nothing about that."""

ALIKE_S = 20.0
"""Fixes of one receiver within such a time err alike, by the same satellites and the same reflections:
together they count as one."""

LEAST_SPEED_MPS = 0.3
"""Without odometry, the heading is that of a movement that is faster, and faster than it is uncertain."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What the filter thought of the fixes of one track.

    Attributes
    ----------
    number : (m,) intp
        Places in the track as it was given, ordered by time.
    distance : (m,) float64
        Squared Mahalanobis distance from the prediction; 2 in the mean when all covariances are right.
    gated : (m,) bool
        Which were left out.
    expected : (m, 2) float64
        Where they were predicted, degrees north and east.
    off_m : (m,) float64
        How far from there they are.
    """

    number: NDArray[np.intp]
    distance: Floats
    gated: NDArray[np.bool_]
    expected: Floats
    off_m: Floats

    @property
    def mean_distance(self) -> float:
        """Mean over the fixes that were used; NaN without any."""
        used = self.distance[~self.gated]
        return float(used.mean()) if used.size else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A corrected track.

    Attributes
    ----------
    poses : Poses
        At each time of the odometry and of the fixes.
    judged : dict of Source to Judged
    begins_s : tuple of float
        When each piece begins; the first one begins with the track, at the others it was found elsewhere.
    fit : Fit
        How much more wrong than usual, or than told, odometry and receiver turned out to be.
    """

    poses: Poses
    judged: dict[Source, Judged]
    begins_s: tuple[float, ...]
    fit: Fit


@dataclass(frozen=True, slots=True)
class NoFusion:
    """Nothing to put together, and why. Falsy."""

    reason: str

    def __bool__(self) -> bool:
        """Say that there is no track."""
        return False


def fuse(
    odometry: Poses | None,
    fixes: Mapping[Source, Poses],
    *,
    noise: Noise | None = None,
    check: Callable[[int], None] = lambda _: None,
) -> Fusion | NoFusion:
    """Correct a reckoned track by fixes, or smooth fixes alone.

    Parameters
    ----------
    odometry : Poses or None
        Reckoned; where it began, and its own covariance, count for nothing.
    fixes : mapping of Source to Poses
        Their covariances are believed where they are told.
    noise : Noise, optional
    check : callable
        Told now and then how many nodes are done; what it raises ends the work.
    """
    tracks = {source: poses for source, poses in fixes.items() if len(poses)}
    if not tracks:
        return NoFusion("there is no fix that a track could be corrected by")
    every = _all_fixes(tracks, most=MOST_POSES)
    frame = LocalFrame(centre_of(every.poses.latlon))
    usual = noise or Noise()
    found = _fit(odometry, tracks, frame=frame, usual=usual)
    steps, told = _taken_in(odometry, every, frame=frame, most=MOST_POSES)
    measured = found.fixes(told, of_receiver=every.source == "gps")
    done = smooth(steps, measured, noise=found.noise(usual), check=check)
    poses = _poses(steps, done, frame=frame, height_m=_heights(every, steps.times_s, done.gated))
    expected = frame.latlon_from_enu(done.expected)
    off_m = np.hypot(*(measured.position - done.expected).T)
    judged = {
        source: Judged(every.number[mine], done.distance[mine], done.gated[mine], expected[mine], off_m[mine])
        for source in tracks
        for mine in [every.source == source]
    }
    return Fusion(poses, judged, tuple(steps.times_s[list(done.begins)].tolist()), found)


def _fit(odometry: Poses | None, tracks: Mapping[Source, Poses], *, frame: LocalFrame, usual: Noise) -> Fit:
    """Find how wrong odometry and receiver are, by fixes that err each on its own."""
    apart = {source: _apart(poses) if source == "gps" else poses for source, poses in tracks.items()}
    sample = _all_fixes(apart, most=SAMPLE)
    if len(sample.number) < LEAST_SAMPLE:
        return Fit()
    steps, fixes = _taken_in(odometry, sample, frame=frame, most=4 * SAMPLE)
    return fit(steps, fixes, of_receiver=sample.source == "gps", usual=usual)


def _apart(poses: Poses) -> Poses:
    """Give fixes that do not err alike."""
    order = np.argsort(poses.times_s, kind="stable")
    turn = np.floor((poses.times_s[order] - poses.times_s[order[0]]) / ALIKE_S)
    return poses.take(order[np.unique(turn, return_index=True)[1]])


def _taken_in(
    odometry: Poses | None, every: _AllFixes, *, frame: LocalFrame, most: int
) -> tuple[Steps, Fixes]:
    """Bring odometry and fixes to what the filter takes in."""
    reckoning = None if odometry is None else _reckoning(odometry, most)
    times = every.poses.times_s
    nodes = np.unique(times if reckoning is None else np.concatenate([times, reckoning.times_s]))
    fixes = Fixes(
        np.searchsorted(nodes, times),
        frame.enu_from_latlon(every.poses.latlon),
        _covariances(every),
        _shares(every),
    )
    return make_steps(nodes, reckoning), fixes


@dataclass(frozen=True, slots=True, eq=False)
class _AllFixes:
    """The fixes of all sources, ordered by time: their poses, where each is from, and its place there."""

    poses: Poses
    source: NDArray[np.str_]
    number: NDArray[np.intp]


def _in_time(poses: Poses, most: int) -> NDArray[np.intp]:
    """Places of the poses in the order of time; of too many, some."""
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
    """Give each fix a covariance (m, 2, 2): its own, or that of its source."""
    east, north, both = fixes.poses.covariance_m2.T
    usual = np.array([UNTOLD_M[source] for source in fixes.source.tolist()]) ** 2
    told = (east >= 0) & (north >= 0) & (both**2 <= east * north)
    found = np.empty((len(usual), 2, 2))
    found[:, 0, 0] = np.where(told, np.maximum(east, LEAST_M**2), usual)
    found[:, 1, 1] = np.where(told, np.maximum(north, LEAST_M**2), usual)
    found[:, 0, 1] = found[:, 1, 0] = np.where(told, both, 0.0)
    return found


def _shares(fixes: _AllFixes) -> Floats:
    """Tell how much of an independent measurement each fix is, by the time to the one before it."""
    found = np.ones(len(fixes.source))
    of_gps = fixes.source == "gps"
    waited = np.diff(fixes.poses.times_s[of_gps], prepend=-np.inf)
    found[of_gps] = np.clip(waited / ALIKE_S, 1e-3, 1.0)
    return found


def _reckoning(odometry: Poses, most: int) -> Reckoning | None:
    """Lay odometry into a plane of its own; None for too little of it."""
    poses = odometry.take(_in_time(odometry, most))
    poses = poses.take(np.unique(poses.times_s, return_index=True)[1])
    if len(poses) < 2:
        return None
    position = LocalFrame(centre_of(poses.latlon)).enu_from_latlon(poses.latlon)
    return Reckoning(poses.times_s, position, _headings(np.radians(poses.heading_deg), position))


def _headings(told: Floats, position: Floats) -> Floats:
    """Give each pose a heading without jumps: as most of them tell, else that of the way to the next."""
    known = np.flatnonzero(np.isfinite(told))
    if 2 * known.size >= len(told):
        return np.interp(np.arange(len(told)), known, np.unwrap(told[known]))
    moves = np.diff(position, axis=0)
    known = np.flatnonzero(np.hypot(*moves.T) > 0)
    if not known.size:
        return np.zeros(len(told))
    at = np.clip(np.searchsorted(known, np.arange(len(told))), 0, known.size - 1)
    return np.unwrap(np.arctan2(moves[:, 0], moves[:, 1])[known])[at]


def _heights(fixes: _AllFixes, nodes: Floats, gated: NDArray[np.bool_]) -> Floats:
    """Take the height of each node from the fixes around it that were used; NaN where none tells one."""
    known = ~gated & np.isfinite(fixes.poses.height_m)
    if not known.any():
        return np.full(len(nodes), np.nan)
    return np.interp(nodes, fixes.poses.times_s[known], fixes.poses.height_m[known])


def _poses(steps: Steps, done: Smoothed, *, frame: LocalFrame, height_m: Floats) -> Poses:
    reckoned = np.isfinite(steps.moves[:, 0])
    reckoned[:-1] |= reckoned[1:]
    state, covariance = done.state, done.covariance
    speed = np.hypot(*state[:, VELOCITY].T)
    spread = np.sqrt(np.trace(covariance[:, VELOCITY, VELOCITY], axis1=1, axis2=2))
    course = np.where(
        speed > np.maximum(spread, LEAST_SPEED_MPS), np.arctan2(state[:, 2], state[:, 3]), np.nan
    )
    way = np.hypot(*np.diff(state[:, POSITION], axis=0).T)
    way[[begin - 1 for begin in done.begins[1:]]] = 0.0  # from piece to piece nobody travelled
    return make_poses(
        steps.times_s,
        frame.latlon_from_enu(state[:, POSITION]),
        height_m=height_m,
        heading_deg=np.degrees(np.where(reckoned, state[:, HEADING], course)),
        covariance_m2=covariance[:, [0, 1, 0], [0, 1, 1]],
        travelled_m=np.concatenate([[0.0], np.cumsum(way)]),
    )
