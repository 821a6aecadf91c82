"""A forward extended Kalman filter over a track, with gating, and a backward smoother.

The forward pass updates the prediction with each fix, and rejects a fix outside the gate. The backward pass
uses the measurements after each node (H. Rauch, F. Tung and C. Striebel, "Maximum likelihood estimates of
linear dynamic systems", AIAA Journal 3, 1965). Several rejected fixes in a row that agree with each other are
right: the robot was carried, or its odometry has slipped far, and a new piece begins. Both passes run twice,
the second time linearised about the first result (B. Bell, "The iterated Kalman smoother as a Gauss-Newton
method", SIAM Journal on Optimization 4, 1994).

The filter is implemented here because the state is small, gating is essential, and available libraries are
unmaintained or depend on a whole optimiser.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.robust import GATE_2D
from webapp.missions.core.trajectory.alignment import InitialState, start
from webapp.missions.core.trajectory.motion import POSITION, SIZE, Noise, predict
from webapp.missions.core.trajectory.steps import Fixes, Floats, Steps

AGREEING = 5
"""Least number of rejected fixes in a row that agree with each other and begin a new piece..."""

AGREEING_S = 10.0
"""... over at least this many seconds: for shorter times, multipath often misleads a receiver."""

LEAST_WEIGHT = 1e-6
"""A fix of less weight is ignored."""

_CHECK_EVERY = 1000


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedTrack:
    """A smoothed track."""

    state: Floats  # (n, 8) float64. At each node; see `motion`.
    covariance: Floats  # (n, 8, 8) float64
    begins: tuple[int, ...]  # The first node of each piece
    distance: Floats  # (m,) float64. Squared Mahalanobis distance of each fix from its prediction.
    gated: NDArray[np.bool_]  # (m,) bool. Which fixes were rejected.
    expected: Floats  # (m, 2) float64. Predicted position of each fix, metres east and north.


@dataclass(frozen=True, slots=True, eq=False)
class OutlierLabels:
    """Outliers among the fixes, and the pieces between which the robot was carried, by the whole track."""

    weight: Floats  # (m,) float64. 0 for a wrong fix, 1 for a good one; NaN where it is not judged.
    begins_s: tuple[float, ...]  # Start time of each piece


def smooth(
    steps: Steps,
    fixes: Fixes,
    *,
    noise: Noise | None = None,
    judged: OutlierLabels | None = None,
    check: Callable[[int], None] = lambda _: None,
) -> SmoothedTrack:
    """Filter a track forward and smooth it backward, twice.

    Args:
        fixes: At least one.
        judged: Without it, fixes are gated by their predictions, and pieces begin where several are rejected.
        check: Called now and then with the number of nodes done; an exception that it raises cancels the
            work.
    """
    filter = Filter(steps, fixes, noise=noise or Noise(), weight=None if judged is None else judged.weight)
    ends = None if judged is None else _ends(steps, judged.begins_s)
    begins: list[int] = []
    node = 0
    while node < len(steps):
        begun = filter.begun(node)
        end = filter.forward(node, begun, check=check, end=None if ends is None else ends[len(begins)])
        begins.append(node)
        filter.back(node, end)
        # a second pass, linearised about the first result: where the heading was poorly known, linearisation
        # about the filter's states is inaccurate; a third pass hardly changes anything
        filter.forward(node, begun, check=check, end=end, around_last=True)
        filter.back(node, end)
        node = end
    if judged is not None:
        _compare_with_whole_track(filter, judged)
    return SmoothedTrack(
        filter.state, filter.covariance, tuple(begins), filter.distance, filter.gated, filter.expected
    )


def _ends(steps: Steps, begins_s: tuple[float, ...]) -> list[int]:
    """Return the node after the last one of each piece."""
    return [*np.searchsorted(steps.times_s, begins_s[1:]).tolist(), len(steps)]


def _compare_with_whole_track(filter: Filter, judged: OutlierLabels) -> None:
    """Predict the fixes that were judged wrong from the smoothed track, which does not use them."""
    for at in np.flatnonzero(judged.weight == 0.0).tolist():
        node = filter.fixes.node[at]
        filter.expected[at] = filter.state[node, POSITION]
        off = filter.fixes.position[at] - filter.expected[at]
        around = filter.covariance[node, POSITION, POSITION] + filter.fixes.covariance[at]
        filter.distance[at] = off @ np.linalg.solve(around, off)


class Filter:
    """An extended Kalman filter and smoother, with the arrays of one run.

    Args:
        weight: (m,) float64. Of each fix, 0 to 1; NaN where the filter gates a fix by its prediction, as it
            does without weights. The array may be changed between passes.
    """

    def __init__(self, steps: Steps, fixes: Fixes, *, noise: Noise, weight: Floats | None = None) -> None:
        n, m = len(steps), len(fixes)
        self.steps, self.fixes, self.noise = steps, fixes, noise
        self.weight = np.full(m, np.nan) if weight is None else weight
        self.state, self.covariance = np.empty((n, SIZE)), np.empty((n, SIZE, SIZE))
        self._predicted, self._uncertain = np.empty((n, SIZE)), np.empty((n, SIZE, SIZE))
        self._change = np.empty((n, SIZE, SIZE))
        self.distance, self.gated = np.full(m, np.nan), np.zeros(m, dtype=bool)
        self.expected = np.full((m, 2), np.nan)

    def begun(self, node: int) -> InitialState:
        """Estimate the initial state at a node."""
        used = (self.fixes.node >= node) & ~(self.weight < LEAST_WEIGHT)
        later = self.fixes.take(used if used.any() else self.fixes.node >= node)
        return start(self.steps, later, begin=node, noise=self.noise)

    def forward(
        self,
        begin: int,
        begun: InitialState,
        *,
        check: Callable[[int], None] = lambda _: None,
        end: int | None = None,
        around_last: bool = False,
    ) -> int:
        """Filter forward from a node to the end of its piece; return the node after the last.

        The piece ends at `end`, or without it where a new piece is detected. With `around_last`, motions are
        linearised about the last smoothed states.
        """
        steps, fixes = self.steps, self.fixes
        at = int(np.searchsorted(fixes.node, begin))
        state, covariance = begun.state, begun.covariance
        pending: list[int] = []
        stop = len(steps) if end is None else end
        around = self.state[begin:stop].copy() if around_last else None
        for node in range(begin, stop):
            if node > begin:
                at_state = state if around is None else around[node - 1 - begin]
                state, covariance = self._predict(node, state, covariance, around=at_state)
            while at < len(fixes) and fixes.node[at] == node:
                state, covariance = self._update(at, state, covariance)
                pending = [*pending, at] if self.gated[at] else []
                at += 1
                tested = end is None and pending and fixes.node[pending[0]] > begin
                if tested and self._carried(pending):
                    return int(fixes.node[pending[0]])
            self.state[node], self.covariance[node] = state, covariance
            if node % _CHECK_EVERY == 0:
                check(node)
        return stop

    def _predict(
        self, node: int, state: Floats, covariance: Floats, *, around: Floats
    ) -> tuple[Floats, Floats]:
        seconds = float(self.steps.times_s[node] - self.steps.times_s[node - 1])
        after, change, added = predict(around, self.steps.moves[node], seconds=seconds, noise=self.noise)
        after = after + change @ (state - around)
        uncertain = change @ covariance @ change.T + added
        self._predicted[node], self._uncertain[node], self._change[node] = after, uncertain, change
        return after, uncertain

    def _update(self, at: int, state: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Update the prediction with a fix, or reject the fix."""
        measured = self.fixes.covariance[at]
        off = self.fixes.position[at] - state[POSITION]
        around = covariance[POSITION, POSITION] + measured
        self.expected[at] = state[POSITION]
        self.distance[at] = off @ np.linalg.solve(around, off)
        weight = float(self.weight[at])
        by_distance = math.isnan(weight)
        self.gated[at] = self.distance[at] > GATE_2D if by_distance else weight < LEAST_WEIGHT
        if self.gated[at]:
            return state, covariance
        weight = 1.0 if by_distance else weight
        counts = measured / (self.fixes.share[at] * weight)
        gain = covariance[:, POSITION] @ np.linalg.inv(covariance[POSITION, POSITION] + counts)
        # the Joseph form keeps the covariance positive definite despite rounding
        keep = np.eye(SIZE)
        keep[:, POSITION] -= gain
        return state + gain @ off, keep @ covariance @ keep.T + gain @ counts @ gain.T

    def _carried(self, pending: list[int]) -> bool:
        """Return whether enough rejected fixes agree (the robot was carried); of too many, drop the first."""
        times = self.steps.times_s[self.fixes.node[pending]]
        if len(pending) < AGREEING or times[-1] - times[0] < AGREEING_S:
            return False
        few = np.unique(np.linspace(0, len(pending) - 1, AGREEING).astype(np.intp))
        chosen = self.fixes.take(np.array(pending)[few])
        if start(self.steps, chosen, begin=int(chosen.node[0]), noise=self.noise).agrees.all():
            return True
        del pending[0]
        return False

    def back(self, first: int, end: int) -> None:
        """Smooth the nodes of a piece, backward."""
        for node in range(end - 2, first - 1, -1):
            after = node + 1
            # C = P F' (P_predicted)^-1, of symmetric matrices
            gain = np.linalg.solve(self._uncertain[after], self._change[after] @ self.covariance[node]).T
            self.state[node] += gain @ (self.state[after] - self._predicted[after])
            spread = self.covariance[after] - self._uncertain[after]
            smoothed = self.covariance[node] + gain @ spread @ gain.T
            self.covariance[node] = (smoothed + smoothed.T) / 2


def mean_distance_bounds(count: int) -> tuple[float, float]:
    """Return the 95 % bounds of the mean squared distance of `count` good fixes.

    The sum of the distances follows the chi-square distribution with 2 `count` degrees of freedom, which is
    approximated after E. Wilson and M. Hilferty, "The distribution of chi-square", PNAS 17 (1931).
    """
    degrees = 2 * count
    spread = 1.96 * math.sqrt(2 / (9 * degrees))
    low, high = (2 * max(0.0, 1 - 2 / (9 * degrees) + sign * spread) ** 3 for sign in (-1, 1))
    return low, high
