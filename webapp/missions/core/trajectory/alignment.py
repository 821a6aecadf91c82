"""Initial state of a filter: position and heading from the first fixes, some of which may be wrong.

The odometry's path is aligned with the fixes by a rotation and a translation. Each pair of fixes proposes a
rotation; the one with the most inliers is refined on them (M. Fischler and R. Bolles, "Random sample
consensus", Communications of the ACM 24, 1981, but with all pairs instead of random ones; the refinement is
the closed form of S. Umeyama, IEEE PAMI 13, 1991, in the plane).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry.robust import GATE_2D
from webapp.missions.core.trajectory.motion import (
    CURVE,
    HEADING,
    POSITION,
    SCALE,
    SIZE,
    TURN_SCALE,
    VELOCITY,
    Noise,
)
from webapp.missions.core.trajectory.steps import Fixes, Floats, Steps, path

MOST_FIXES = 24
FAR = 10.0
"""Length of path that determines a heading, in standard deviations of a fix."""

SURE_HEADING_RAD = 0.25
"""Largest standard deviation of a heading that is taken from fixes."""

GIVEN_HEADING_RAD = 0.5
"""Standard deviation of the odometry's own heading: at its start, a person entered it."""

WIDER = 9.0
"""Factor on the initial covariance, as the first fixes are used twice: here and in the filter."""


@dataclass(frozen=True, slots=True, eq=False)
class InitialState:
    """An initial state."""

    state: Floats  # (8,) float64
    covariance: Floats  # (8, 8) float64
    agrees: NDArray[np.bool_]  # (m,) bool. Which of the given fixes agree with it.


def start(steps: Steps, fixes: Fixes, *, begin: int, noise: Noise) -> InitialState:
    """Estimate the state at a node from the fixes at and after it.

    Args:
        fixes: All at `begin` or later; at least one. Only the first of them are used.
        begin: The node.
    """
    spread = np.sqrt(np.trace(fixes.covariance, axis1=1, axis2=2) / 2)
    found = _nearby(steps, fixes, spread, begin=begin, noise=noise)
    known = np.flatnonzero(np.isfinite(steps.moves[begin + 1 :, 0]))
    if not known.size:
        return found
    first = begin + int(known[0])
    gaps = np.flatnonzero(np.isnan(steps.moves[first + 1 :, 0]))
    last = first + int(gaps[0]) if gaps.size else len(steps) - 1
    found.state[HEADING] = steps.heading_rad[first]
    inside = np.flatnonzero((fixes.node >= first) & (fixes.node <= last))
    aligned = None
    if inside.size >= 3:
        seen = fixes.take(inside)
        way = path(steps, first, last=int(seen.node[-1]))[seen.node - first]
        begun = int(seen.node[0])
        drift = _drift(steps, begun, last=int(seen.node[-1]), noise=noise)[seen.node - begun]
        aligned = _aligned(way, seen.position, variance=spread[inside] ** 2 + drift**2)
    if aligned is None:
        return found
    aligned = _before(aligned, steps, range(first, int(fixes.node[inside[0]])), noise=noise)
    found.state[HEADING] = aligned.heading
    found.covariance[HEADING, HEADING] = aligned.heading_variance
    if first > begin:  # the odometry begins later: only the heading can be used
        return found
    _place(found, aligned)
    agrees = np.zeros(len(fixes), dtype=bool)
    agrees[inside[aligned.agrees]] = True
    return InitialState(found.state, found.covariance, agrees)


def _before(aligned: _Alignment, steps: Steps, nodes: range, *, noise: Noise) -> _Alignment:
    """Add the uncertainty of dead reckoning before the first fix."""
    way = float(_reach(steps, nodes.start, last=nodes.stop, noise=noise)[-1])
    drift = float(_drift(steps, nodes.start, last=nodes.stop, noise=noise)[-1])
    turned = float(np.abs(steps.moves[nodes.start + 1 : nodes.stop + 1, 2]).sum())
    bent = (noise.curve * way) ** 2 + (noise.turn_scale * turned) ** 2 + noise.heading**2 * way
    return replace(
        aligned,
        at_variance=aligned.at_variance + drift**2,
        heading_variance=aligned.heading_variance + bent,
    )


def _place(found: InitialState, aligned: _Alignment) -> None:
    """Set the position of a state from an alignment, and its correlation with the heading."""
    lever = np.array([aligned.at_by_heading.real, aligned.at_by_heading.imag])
    found.state[POSITION] = aligned.at.real, aligned.at.imag
    both = np.outer(lever, lever) * aligned.heading_variance
    found.covariance[POSITION, POSITION] = np.eye(2) * aligned.at_variance + both
    found.covariance[POSITION, HEADING] = lever * aligned.heading_variance
    found.covariance[HEADING, POSITION] = lever * aligned.heading_variance


def _prior(noise: Noise) -> Floats:
    covariance = np.zeros((SIZE, SIZE))
    covariance[VELOCITY, VELOCITY] = np.eye(2) * noise.velocity**2
    covariance[HEADING, HEADING] = GIVEN_HEADING_RAD**2
    covariance[SCALE, SCALE] = noise.scale**2
    covariance[TURN_SCALE, TURN_SCALE] = noise.turn_scale**2
    covariance[CURVE, CURVE] = noise.curve**2
    return covariance


def _nearby(steps: Steps, fixes: Fixes, spread: Floats, *, begin: int, noise: Noise) -> InitialState:
    """Begin at the one of the first fixes that is most consistent with the others."""
    few = slice(0, 7)
    at, nodes, variance = fixes.position[few], fixes.node[few], spread[few] ** 2
    reach = _reach(steps, begin, last=int(nodes[-1]), noise=noise)[nodes - begin]
    apart = np.linalg.norm(at[:, None] - at, axis=2)
    off = apart**2 / (variance[:, None] + variance + (reach[:, None] - reach) ** 2)
    chosen = int(np.minimum(off, GATE_2D).sum(axis=1).argmin())
    state, covariance = np.zeros(SIZE), _prior(noise)
    state[POSITION] = at[chosen]
    before = np.eye(2) * float(reach[chosen]) ** 2
    covariance[POSITION, POSITION] = fixes.covariance[chosen] * WIDER + before
    agrees = np.zeros(len(fixes), dtype=bool)
    agrees[few] = off[chosen] <= GATE_2D
    return InitialState(state, covariance, agrees)


def _reach(steps: Steps, begin: int, *, last: int, noise: Noise) -> Floats:
    """Return how far a robot may have moved from a node to each later one: (last - begin + 1,) metres."""
    moves = steps.moves[begin + 1 : last + 1]
    guessed = noise.velocity * np.diff(steps.times_s[begin : last + 1])
    driven = np.hypot(moves[:, 0], moves[:, 1])
    return np.concatenate([[0.0], np.cumsum(np.where(np.isnan(driven), guessed, driven))])


def _drift(steps: Steps, first: int, *, last: int, noise: Noise) -> Floats:
    """Return the standard deviation of dead reckoning from a node to each later one, as `_reach`."""
    way = _reach(steps, first, last=last, noise=noise)
    turned = np.concatenate([[0.0], np.cumsum(np.abs(steps.moves[first + 1 : last + 1, 2]))])
    bent = np.hypot(noise.curve * way, noise.turn_scale * turned) / 2
    return np.asarray(way * np.sqrt(noise.scale**2 + bent**2 + noise.heading**2 * way / 3))


@dataclass(frozen=True, slots=True, eq=False)
class _Alignment:
    """Alignment of a path with fixes: its start, the derivative of that by the heading, and the heading."""

    at: complex
    at_by_heading: complex
    at_variance: float
    heading: float
    heading_variance: float
    agrees: NDArray[np.bool_]


def _aligned(way: Floats, position: Floats, *, variance: Floats) -> _Alignment | None:
    """Align a path with fixes by a rotation and a translation; None if it is too short for a heading."""
    chosen = _window(way, variance)
    p, z = (points[chosen] @ np.array([1, 1j]) for points in (way, position))
    agrees = _agreeing(p, z, variance[chosen])
    if agrees is None:
        return None
    weight = np.where(agrees, 1 / variance[chosen], 0.0)
    p_mean, z_mean = (complex(weight @ points / weight.sum()) for points in (p, z))
    lever = float(weight @ np.abs(p - p_mean) ** 2)
    if lever * SURE_HEADING_RAD**2 < 1:
        return None
    turn = np.exp(1j * np.angle(weight @ (np.conj(p - p_mean) * (z - z_mean))))
    everyone = np.zeros(len(way), dtype=bool)
    everyone[chosen[agrees]] = True
    return _Alignment(
        at=complex(z_mean - p_mean * turn),
        at_by_heading=complex(1j * p_mean * turn),
        at_variance=WIDER / float(weight.sum()),
        # the path was computed as if it started northwards; angles of complex numbers are anticlockwise
        heading=-float(np.angle(turn)),
        heading_variance=WIDER / lever,
        agrees=everyone,
    )


def _agreeing(
    p: NDArray[np.complex128], z: NDArray[np.complex128], variance: Floats
) -> NDArray[np.bool_] | None:
    """Find the largest consistent set of fixes `z` for the path `p`; None for too few."""
    one, two = np.triu_indices(len(p), 1)
    useful = np.abs(p[two] - p[one]) > 2 * np.sqrt(variance[one] + variance[two])
    if not useful.any():
        return None
    one, two = one[useful], two[useful]
    turns = np.exp(1j * np.angle((z[two] - z[one]) / (p[two] - p[one])))
    middle = (z[one] + z[two] - (p[one] + p[two]) * turns) / 2
    off = np.abs(z - middle[:, None] - p * turns[:, None]) ** 2 / variance
    agrees = np.asarray(off[np.minimum(off, GATE_2D).sum(axis=1).argmin()] <= GATE_2D)
    return agrees if agrees.sum() >= 3 else None


def _window(way: Floats, variance: Floats) -> NDArray[np.intp]:
    """Choose the first fixes, until the path is long enough for a heading."""
    away = np.linalg.norm(way - way[0], axis=1)
    far = np.flatnonzero(away >= FAR * np.sqrt(variance.min()))
    count = max(3, int(far[0]) + 1) if far.size else len(way)
    return np.unique(np.linspace(0, count - 1, min(count, MOST_FIXES)).astype(np.intp))
