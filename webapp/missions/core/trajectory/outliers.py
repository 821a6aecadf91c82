"""Finds wrong fixes by the whole track, from the measurements after each fix as well as those before.

A forward filter must judge each fix as it arrives. After a long distance its prediction is uncertain: it
accepts a wrong fix, and then rejects good ones. Here all fixes are weighted jointly under a truncated
quadratic loss, constant beyond the gate of a good fix, by graduated non-convexity: the loss is nearly convex
at first and truncated step by step, while the smoother estimates the best track for the weights of each step
(H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated non-convexity for robust spatial perception", IEEE
Robotics and Automation Letters 5, 2020).

With equal weights, wrong fixes would bend the first track too far for a useful linearisation. It is therefore
estimated from the fixes whose distances from their neighbours agree with the odometry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.robust import GATE_2D
from webapp.missions.core.trajectory.alignment import start
from webapp.missions.core.trajectory.motion import POSITION, Noise
from webapp.missions.core.trajectory.smoother import (
    AGREEING,
    AGREEING_S,
    Filter,
    OutlierLabels,
    log_likelihood,
)
from webapp.missions.core.trajectory.steps import Fixes, Floats, Steps, path

GROWTH = 1.8
"""Factor by which the loss becomes less convex in each step."""

INITIAL_MU = 0.3
"""Initial degree of non-convexity: fairly high, as the first weights are already good."""

MOST_STEPS = 40

NEIGHBOURS = 4
"""Number of fixes before and after one with which it is compared."""

DISTANCE_TOLERANCE = 0.05
"""Tolerance of distances for scale and turn errors of the odometry, as a fraction of the path length."""

LEADING = (0, 3, 6)
"""Numbers of first fixes that a receiver which has just started may have wrong together."""

FASTEST = 3.0
"""Limit of the speed without odometry, in standard deviations of the velocity along an axis."""

READMISSIONS = 3
"""Largest number of rounds in which rejected fixes are tested again against the track without them."""


def find_outliers(
    steps: Steps,
    fixes: Fixes,
    *,
    noise: Noise,
    leading: Sequence[int] = (0,),
    check: Callable[[int], None] = lambda _: None,
) -> OutlierLabels:
    """Judge all fixes jointly; a run of wrong fixes that agree with each other begins a new piece.

    Args:
        fixes: At least one.
        leading: Numbers of first fixes that are assumed to be wrong together, in turn; the assumption under
            which all fixes are most likely is kept.
        check: Called now and then; raises if the work was cancelled.

    Without odometry, the motion between fixes is limited by the robot's speed only.
    """
    if not np.isfinite(steps.moves).any():
        return OutlierLabels(_by_motion(steps, fixes, noise=noise, check=check), (float(steps.times_s[0]),))
    assumed = [few for few in leading if few < len(fixes) // 2] or [0]
    found = [_labels(steps, fixes, noise=noise, leading=few, check=check) for few in assumed]
    if len(found) == 1:
        return found[0]
    return max(found, key=lambda labels: log_likelihood(steps, fixes, noise=noise, judged=labels))


def _labels(
    steps: Steps, fixes: Fixes, *, noise: Noise, leading: int, check: Callable[[int], None]
) -> OutlierLabels:
    """Judge all fixes, except for the `leading` first ones, which are assumed to be wrong."""
    gated = np.zeros(len(fixes), dtype=bool)
    begins: list[int] = []
    waiting = [(0, len(steps))]
    while waiting:
        begin, end = waiting.pop()
        mine = (fixes.node >= begin) & (fixes.node < end)
        if mine.any():
            few = leading if begin == 0 and mine.sum() > 2 * leading else 0
            piece = range(begin, end)
            gated[mine] = _judge(steps, fixes, noise=noise, piece=piece, leading=few, check=check)[mine]
        split = _first_of_consistent_run(steps, fixes, np.flatnonzero(mine), gated=gated, noise=noise)
        if split is None or not begin < split < end:
            begins.append(begin)
        else:
            waiting += [(split, end), (begin, split)]
    begins_s = tuple(sorted(steps.times_s[begins].tolist()))
    return OutlierLabels(np.where(gated, 0.0, 1.0), begins_s)


def _judge(
    steps: Steps, fixes: Fixes, *, noise: Noise, piece: range, leading: int, check: Callable[[int], None]
) -> NDArray[np.bool_]:
    """Return which fixes are wrong (m,); only those at the nodes of a piece are judged."""
    begin, end = piece.start, piece.stop
    mine = (fixes.node >= begin) & (fixes.node < end)
    weight = _consistent(steps, fixes, mine=mine, noise=noise).astype(np.float64)
    held = np.zeros(len(fixes), dtype=bool)
    held[np.flatnonzero(mine)[:leading]] = True
    weight[held] = 0.0
    if not weight.any():
        weight[mine & ~held] = 1.0
    filter = Filter(steps, fixes, noise=noise, weight=weight)
    begun = start(steps, fixes.take((weight > 0) & (fixes.node >= begin)), begin=begin, noise=noise)
    filter.forward(begin, begun, check=check, end=end)
    filter.back(begin, end)
    inverse = np.linalg.inv(fixes.covariance)

    def solve() -> Floats:
        filter.forward(begin, begun, check=check, end=end, around_last=True)
        filter.back(begin, end)
        off = fixes.position - filter.state[fixes.node, POSITION]
        return np.where(mine, np.einsum("mi,mij,mj->m", off, inverse, off), 0.0)

    solve()
    distance, control = solve(), INITIAL_MU
    for _ in range(MOST_STEPS):
        weight[:] = np.where(held, 0.0, _weights(distance, control))
        distance = solve()
        if ((weight < 1e-3) | (weight > 1 - 1e-3)).all():
            break
        control *= GROWTH
    for _ in range(READMISSIONS):
        gated = (_far(filter, fixes, weight) | held) & mine
        if np.array_equal(gated, weight < 0.5):
            break
        weight[:] = ~gated
        solve()
    return np.asarray((weight < 0.5) & mine)


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


def _by_motion(steps: Steps, fixes: Fixes, *, noise: Noise, check: Callable[[int], None]) -> Floats:
    """Return 1 for each fix (m,) that the robot could reach from others that it could reach, else 0.

    The fixes of the longest chain that respects the limit of speed are smoothed. Then those farther from the
    track that the others make than all but one in a thousand good fixes are left out, one of each
    neighbourhood at a time, and those that fit are taken back.
    """
    weight = _reachable(steps, fixes, most_mps=FASTEST * noise.velocity).astype(np.float64)
    filter = Filter(steps, fixes, noise=noise, weight=weight)
    for _ in range(MOST_STEPS):
        filter.forward(0, filter.begun(0), check=check, end=len(steps))
        filter.back(0, len(steps))
        off = fixes.position - filter.state[fixes.node, POSITION]
        # the track was drawn towards the fixes that it uses: the covariance of a residual is the difference
        sign = np.where(weight > 0.5, -fixes.share, 1.0)[:, None, None]
        around = fixes.covariance + sign * filter.covariance[fixes.node, POSITION, POSITION]
        distance = np.einsum("mi,mi->m", off, np.linalg.solve(around, off[:, :, None])[:, :, 0])
        used = np.where(weight > 0.5, distance, 0.0)
        padded = np.pad(used, NEIGHBOURS)
        greatest = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).max(axis=1)
        worst = (used > GATE_2D) & (used == greatest)
        fitting = (weight < 0.5) & (distance < GATE_2D)
        if not worst.any():
            break
        weight[worst] = 0.0
        if fitting.any() and not (worst & fitting).any():
            weight[fitting & (greatest <= GATE_2D)] = 1.0
    return weight


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


def _weights(distance: Floats, control: float) -> Floats:
    """Return the weights of the truncated loss at a degree of non-convexity (equation 14 of the paper)."""
    low, high = control / (control + 1.0) * GATE_2D, (control + 1.0) / control * GATE_2D
    middle = np.sqrt(GATE_2D * control * (control + 1.0) / np.maximum(distance, 1e-12)) - control
    return np.where(distance <= low, 1.0, np.where(distance >= high, 0.0, middle))


def _far(filter: Filter, fixes: Fixes, weight: Floats) -> NDArray[np.bool_]:
    """Return which fixes are too far from the track; for rejected ones, its uncertainty is added."""
    off = fixes.position - filter.state[fixes.node, POSITION]
    spread = filter.covariance[fixes.node, POSITION, POSITION]
    around = fixes.covariance + np.where(weight[:, None, None] < 0.5, spread, 0.0)
    return np.asarray(np.einsum("mi,mi->m", off, np.linalg.solve(around, off[:, :, None])[:, :, 0]) > GATE_2D)


def _first_of_consistent_run(
    steps: Steps, fixes: Fixes, mine: NDArray[np.intp], *, gated: NDArray[np.bool_], noise: Noise
) -> int | None:
    """Return the node of the first fix of a run of wrong fixes that agree; None without one."""
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], gated[mine], [False]]).astype(np.int8)))
    for first, last in bounds.reshape(-1, 2).tolist():
        run = mine[first:last]
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
