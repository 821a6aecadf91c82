"""An extended Kalman filter that goes through a track once, and a smoother that goes back.

Going forward, each fix is weighed against what was predicted, and left out when it is too far off to be
chance. Going back, each node learns from what came after it (H. Rauch, F. Tung and C. Striebel, "Maximum
likelihood estimates of linear dynamic systems", AIAA Journal 3, 1965). Where several fixes in a row are left
out that agree with each other, it is not they that are wrong: the robot was carried, or its odometry has
slipped far, and a new piece begins. All is done twice, the second time linearised where the first came out
(B. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM Journal on Optimization 4, 1994).

The filter is written out here: the state is small, the gating is the point of it, and the libraries at hand
are no longer kept or bring a whole optimiser along.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.trajectory.alignment import GATE, InitialState, start
from webapp.core.trajectory.motion import POSITION, SIZE, Noise, predict
from webapp.core.trajectory.steps import Fixes, Floats, Steps

AGREEING = 5
"""Fixes in a row that are left out and agree with each other: a new piece begins."""

AGREEING_S = 10.0
"""... over at least this many seconds: for shorter times, reflections often mislead a receiver."""

OUTLIERS = 0.01
"""Share of fixes, and of pieces, that are expected to be wrong."""

ANYWHERE_M = 100.0
"""They are expected within such a radius."""

_CHECK_EVERY = 1000


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedTrack:
    """A corrected track.

    Attributes
    ----------
    state : (n, 8) float64
        At each node, as `motion` lists it.
    covariance : (n, 8, 8) float64
    begins : tuple of int
        The first node of each piece.
    distance : (m,) float64
        Squared Mahalanobis distance of each fix from its prediction.
    gated : (m,) bool
        Which fixes were left out.
    expected : (m, 2) float64
        Where each fix was predicted, metres east and north.
    """

    state: Floats
    covariance: Floats
    begins: tuple[int, ...]
    distance: Floats
    gated: NDArray[np.bool_]
    expected: Floats


def smooth(
    steps: Steps, fixes: Fixes, *, noise: Noise | None = None, check: Callable[[int], None] = lambda _: None
) -> SmoothedTrack:
    """Filter a track forward and smooth it backward, twice.

    Parameters
    ----------
    fixes : Fixes
        At least one.
    check : callable
        Called now and then with the number of nodes done; what it raises ends the work.
    """
    filter = _Filter(steps, fixes, noise or Noise())
    begins, node = [], 0
    while node < len(steps):
        begins.append(node)
        begun = filter.begun(node)
        end = filter.forward(node, begun, check)
        filter.back(node, end)
        # Once more, around what came out: after a long way with a heading that was hardly known, straight
        # lines were no good where the filter thought to be. A third time changes next to nothing.
        filter.forward(node, begun, check, again_to=end)
        filter.back(node, end)
        node = end
    return SmoothedTrack(
        filter.state, filter.covariance, tuple(begins), filter.distance, filter.gated, filter.expected
    )


def log_likelihood(steps: Steps, fixes: Fixes, *, noise: Noise) -> float:
    """Return the log-likelihood of fixes, each predicted from those before it.

    A few of them are taken to be anywhere, so that an outlier costs the same however far off it is.
    """
    filter = _Filter(steps, fixes, noise)
    node, pieces = 0, 0
    while node < len(steps):
        node = filter.forward(node, filter.begun(node), lambda _: None)
        pieces += 1
    density = np.exp(-(filter.distance + filter.log_determinant) / 2) / (2 * math.pi)
    anywhere = OUTLIERS / (math.pi * ANYWHERE_M**2)
    return float(np.log((1 - OUTLIERS) * density + anywhere).sum() + pieces * math.log(OUTLIERS))


class _Filter:
    """The arrays of one run."""

    def __init__(self, steps: Steps, fixes: Fixes, noise: Noise) -> None:
        n, m = len(steps), len(fixes)
        self.steps, self.fixes, self.noise = steps, fixes, noise
        self.state, self.covariance = np.empty((n, SIZE)), np.empty((n, SIZE, SIZE))
        self._predicted, self._uncertain = np.empty((n, SIZE)), np.empty((n, SIZE, SIZE))
        self._change = np.empty((n, SIZE, SIZE))
        self.distance, self.gated = np.full(m, np.nan), np.zeros(m, dtype=bool)
        self.expected, self.log_determinant = np.full((m, 2), np.nan), np.full(m, np.nan)

    def begun(self, node: int) -> InitialState:
        """Find a state for a node."""
        later = self.fixes.take(slice(int(np.searchsorted(self.fixes.node, node)), None))
        return start(self.steps, later, begin=node, noise=self.noise)

    def forward(
        self, begin: int, begun: InitialState, check: Callable[[int], None], *, again_to: int | None = None
    ) -> int:
        """Filter from a node on, to the end or to where a new piece begins; give the node after the last.

        With `again_to` the piece ends there, and movements are linearised where the smoother has left them.
        """
        steps, fixes = self.steps, self.fixes
        at = int(np.searchsorted(fixes.node, begin))
        state, covariance = begun.state, begun.covariance
        pending: list[int] = []
        around = None if again_to is None else self.state[begin:again_to].copy()
        for node in range(begin, len(steps) if again_to is None else again_to):
            if node > begin:
                at_state = state if around is None else around[node - 1 - begin]
                state, covariance = self._predict(node, state, covariance, around=at_state)
            while at < len(fixes) and fixes.node[at] == node:
                state, covariance = self._update(at, state, covariance)
                pending = [*pending, at] if self.gated[at] else []
                at += 1
                tested = again_to is None and pending and fixes.node[pending[0]] > begin
                if tested and self._carried(pending):
                    return int(fixes.node[pending[0]])
            self.state[node], self.covariance[node] = state, covariance
            if node % _CHECK_EVERY == 0:
                check(node)
        return len(steps) if again_to is None else again_to

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
        """Weigh a fix against the prediction, or leave it out."""
        measured = self.fixes.covariance[at]
        off = self.fixes.position[at] - state[POSITION]
        around = covariance[POSITION, POSITION] + measured
        self.expected[at] = state[POSITION]
        self.distance[at] = off @ np.linalg.solve(around, off)
        self.log_determinant[at] = math.log(np.linalg.det(around))
        self.gated[at] = self.distance[at] > GATE
        if self.gated[at]:
            return state, covariance
        counts = measured / self.fixes.share[at]
        gain = covariance[:, POSITION] @ np.linalg.inv(covariance[POSITION, POSITION] + counts)
        # Joseph's form keeps the covariance positive, whatever is rounded.
        keep = np.eye(SIZE)
        keep[:, POSITION] -= gain
        return state + gain @ off, keep @ covariance @ keep.T + gain @ counts @ gain.T

    def _carried(self, pending: list[int]) -> bool:
        """Return whether fixes that were left out are right together; forget the first of too many."""
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
        """Smooth the nodes of a piece, the last one first."""
        for node in range(end - 2, first - 1, -1):
            after = node + 1
            # C = P F' (P_predicted)^-1, of symmetric matrices
            gain = np.linalg.solve(self._uncertain[after], self._change[after] @ self.covariance[node]).T
            self.state[node] += gain @ (self.state[after] - self._predicted[after])
            spread = self.covariance[after] - self._uncertain[after]
            smoothed = self.covariance[node] + gain @ spread @ gain.T
            self.covariance[node] = (smoothed + smoothed.T) / 2


def mean_distance_bounds(count: int) -> tuple[float, float]:
    """Return the bounds of the mean squared distance of good fixes in 95 % of the cases.

    The sum of `count` such distances follows the chi-square distribution of 2 `count` degrees; its bounds are
    those of E. Wilson and M. Hilferty, "The distribution of chi-square", PNAS 17 (1931).
    """
    degrees = 2 * count
    spread = 1.96 * math.sqrt(2 / (9 * degrees))
    low, high = (2 * max(0.0, 1 - 2 / (9 * degrees) + sign * spread) ** 3 for sign in (-1, 1))
    return low, high
