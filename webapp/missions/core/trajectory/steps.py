"""Inputs of the filter: odometry increments from node to node, and position fixes at some nodes.

A node is the time of a fix or of a pose of the odometry. Units are metres in a local plane, and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_SPEED_MPS = 40.0
"""A faster increment of odometry is taken for a reset: that motion is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Motion between nodes."""

    times_s: Floats  # (n,) float64. Strictly ascending.
    # (n, 3) float64. Since the previous node, in the robot's own frame there: metres forward, metres to the
    # right, and radians turned clockwise. NaN without odometry, and for the first node.
    moves: Floats
    heading_rad: Floats  # (n,) float64. Of the odometry, clockwise from north; NaN where there is none.

    def __len__(self) -> int:
        """Count the nodes."""
        return len(self.times_s)


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """Measured positions."""

    node: NDArray[np.intp]  # (m,) intp. Node of each fix; ascending.
    position: Floats  # (m, 2) float64. Metres east, metres north.
    covariance: Floats  # (m, 2, 2) float64. Square metres.
    # (m,) float64. Fraction of an independent measurement, 0 < share <= 1: fixes with correlated errors count
    # as one.
    share: Floats

    def __len__(self) -> int:
        """Count the fixes."""
        return len(self.node)

    def take(self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Fixes:
        """Return some of the fixes, in their order."""
        return Fixes(self.node[chosen], self.position[chosen], self.covariance[chosen], self.share[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoning:
    """The path of the odometry, in any plane: only its increments are used."""

    times_s: Floats  # (n,) float64. Strictly ascending.
    position: Floats  # (n, 2) float64. Metres east, metres north.
    heading_rad: Floats  # (n,) float64. Clockwise from north, unwrapped.


def make_steps(times_s: Floats, odometry_path: DeadReckoning | None) -> Steps:
    """Resample the odometry into increments between given times.

    Between two of its poses the robot is assumed to move at constant speed.

    Args:
        times_s: (n,) float64. Strictly ascending.
    """
    n = len(times_s)
    if odometry_path is None or len(odometry_path.times_s) < 2:
        return Steps(times_s, np.full((n, 3), np.nan), np.full(n, np.nan))
    known = odometry_path.times_s
    east, north = (np.interp(times_s, known, axis) for axis in odometry_path.position.T)
    heading = np.interp(times_s, known, odometry_path.heading_rad)
    moves = np.full((n, 3), np.nan)
    de, dn, before = np.diff(east), np.diff(north), heading[:-1]
    moves[1:, 0] = de * np.sin(before) + dn * np.cos(before)
    moves[1:, 1] = de * np.cos(before) - dn * np.sin(before)
    moves[1:, 2] = np.diff(heading)
    inside = (times_s >= known[0]) & (times_s <= known[-1])
    moves[1:][~(inside[1:] & inside[:-1]) | _was_reset(times_s, odometry_path)] = np.nan
    return Steps(times_s, moves, np.where(inside, heading, np.nan))


def _was_reset(times_s: Floats, odometry_path: DeadReckoning) -> NDArray[np.bool_]:
    """Detect the intervals between nodes in which the odometry was reset, (n - 1,)."""
    known = odometry_path.times_s
    speed = np.hypot(*np.diff(odometry_path.position, axis=0).T) / np.diff(known)
    jumped = speed > MOST_SPEED_MPS
    middle = (times_s[1:] + times_s[:-1]) / 2
    at = np.clip(np.searchsorted(known, middle) - 1, 0, len(jumped) - 1)
    return np.asarray(jumped[at])


def path(steps: Steps, first: int, *, last: int) -> Floats:
    """Integrate the increments from one node to another, with the heading of the first as north.

    Args:
        first, last: Nodes with odometry all the way.

    Returns:
        (last - first + 1, 2) float64: Metres right, metres forward of the first node.
    """
    moves = steps.moves[first + 1 : last + 1]
    heading = np.concatenate([[0.0], np.cumsum(moves[:, 2])])[:-1]
    forward, right = moves[:, 0], moves[:, 1]
    de = forward * np.sin(heading) + right * np.cos(heading)
    dn = forward * np.cos(heading) - right * np.sin(heading)
    return np.vstack([np.zeros((1, 2)), np.cumsum(np.column_stack([de, dn]), axis=0)])
