"""Finds wrong fixes by the whole track: what comes after a fix says as much about it as what came before.

A filter that goes forward has to judge each fix when it comes. After a long way its prediction is vague: it
takes a wrong fix, and leaves out good ones that follow. Here all fixes are weighed at once under a truncated
quadratic loss, which stops growing where a fix is farther off than a good one can be, by graduated
non-convexity: the loss is nearly convex first and becomes truncated step by step, while the smoother finds
the best track for the weights of each step (H. Yang, P. Antonante, V. Tzoumas, L. Carlone, "Graduated
non-convexity for robust spatial perception", IEEE Robotics and Automation Letters 5, 2020).

With equal weights, wrong fixes would bend the first track so far that its linearisation is worth nothing.
So it is made of the fixes that are as far from their neighbours as the odometry says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.robust import GATE_2D
from webapp.core.trajectory.alignment import start
from webapp.core.trajectory.motion import POSITION, Noise
from webapp.core.trajectory.smoother import AGREEING, AGREEING_S, Filter, Judgement
from webapp.core.trajectory.steps import Fixes, Floats, Steps, path

GROWTH = 1.8
"""Factor by which the loss becomes less convex in each step."""

INITIAL_MU = 0.3
"""The degree of non-convexity to begin with, as the first weights are good already."""

MOST_STEPS = 40

NEIGHBOURS = 4
"""Fixes before and after one with which it is compared."""

DISTANCE_TOLERANCE = 0.05
"""Share of the way by which a distance changes with the scale and the turns of the odometry."""

READMISSIONS = 3
"""Rounds in which fixes that were left out are tested once more against the track without them."""


def find_outliers(
    steps: Steps, fixes: Fixes, *, noise: Noise, check: Callable[[int], None] = lambda _: None
) -> Judgement | None:
    """Judge all fixes together; where many in a row are wrong and agree, a new piece begins.

    Parameters
    ----------
    fixes : Fixes
        At least one.
    check : callable
        Called now and then; raises where the work was cancelled.

    Returns
    -------
    Judgement or None
        None without odometry: what lies between fixes is unknown then, and each could be right.
    """
    if not np.isfinite(steps.moves).any():
        return None
    gated = np.zeros(len(fixes), dtype=bool)
    begins: list[int] = []
    waiting = [(0, len(steps))]
    while waiting:
        begin, end = waiting.pop()
        mine = (fixes.node >= begin) & (fixes.node < end)
        if mine.any():
            gated[mine] = _judge(steps, fixes, noise=noise, begin=begin, end=end, check=check)[mine]
        split = _first_of_consistent_run(steps, fixes, np.flatnonzero(mine), gated=gated, noise=noise)
        if split is None or not begin < split < end:
            begins.append(begin)
        else:
            waiting += [(split, end), (begin, split)]
    begins_s = tuple(sorted(steps.times_s[begins].tolist()))
    return Judgement(np.where(gated, 0.0, 1.0), begins_s)


def _judge(
    steps: Steps, fixes: Fixes, *, noise: Noise, begin: int, end: int, check: Callable[[int], None]
) -> NDArray[np.bool_]:
    """Return which fixes are wrong (m,); only those of the nodes from `begin` to `end` are judged."""
    mine = (fixes.node >= begin) & (fixes.node < end)
    weight = _consistent(steps, fixes, mine=mine, noise=noise).astype(np.float64)
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
        weight[:] = _weights(distance, control)
        distance = solve()
        if ((weight < 1e-3) | (weight > 1 - 1e-3)).all():
            break
        control *= GROWTH
    for _ in range(READMISSIONS):
        gated = _far(filter, fixes, weight) & mine
        if np.array_equal(gated, weight < 0.5):
            break
        weight[:] = ~gated
        solve()
    return np.asarray((weight < 0.5) & mine)


def _consistent(steps: Steps, fixes: Fixes, *, mine: NDArray[np.bool_], noise: Noise) -> NDArray[np.bool_]:
    """Return which fixes (m,) are as far as the odometry says from at least half of their neighbours.

    Distances need no heading, so that nothing has to be estimated before. In the second round only neighbours
    that were found consistent have a say.
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


def _weights(distance: Floats, control: float) -> Floats:
    """Return the weights of the truncated loss at a degree of convexity (equation 14 of the paper)."""
    low, high = control / (control + 1.0) * GATE_2D, (control + 1.0) / control * GATE_2D
    middle = np.sqrt(GATE_2D * control * (control + 1.0) / np.maximum(distance, 1e-12)) - control
    return np.where(distance <= low, 1.0, np.where(distance >= high, 0.0, middle))


def _far(filter: Filter, fixes: Fixes, weight: Floats) -> NDArray[np.bool_]:
    """Return which fixes are too far from the track: of those left out, its uncertainty counts too."""
    off = fixes.position - filter.state[fixes.node, POSITION]
    spread = filter.covariance[fixes.node, POSITION, POSITION]
    around = fixes.covariance + np.where(weight[:, None, None] < 0.5, spread, 0.0)
    return np.asarray(np.einsum("mi,mi->m", off, np.linalg.solve(around, off[:, :, None])[:, :, 0]) > GATE_2D)


def _first_of_consistent_run(
    steps: Steps, fixes: Fixes, mine: NDArray[np.intp], *, gated: NDArray[np.bool_], noise: Noise
) -> int | None:
    """Return the node of the first of several wrong fixes in a row that agree; None without them."""
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
