"""Motion model of a ground robot: the predicted state at the next node, and its covariance.

The state has eight numbers: metres east and north; metres a second east and north; the heading, radians
clockwise from north; and the systematic errors of the odometry: its scale, the scale of its turns (wheel
separation) and the curvature of a path that it takes for straight (unequal wheels). See J. Borenstein and
L. Feng, "Measurement and correction of systematic odometry errors in mobile robots", IEEE Transactions on
Robotics and Automation 12 (1996).

Where there is odometry, it is the prediction. Elsewhere, the velocity is an Ornstein-Uhlenbeck process, which
decays with time: D. Gillespie, "Exact numerical simulation of the Ornstein-Uhlenbeck process and its
integral", Physical Review E 54 (1996).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from webapp.missions.core.trajectory.steps import Floats

SIZE = 8
POSITION, VELOCITY, HEADING, SYSTEMATIC = slice(0, 2), slice(2, 4), 4, slice(5, 8)
SCALE, TURN_SCALE, CURVE = 5, 6, 7


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the motion, standard deviations; the defaults suit wheeled robots.

    Variances of random errors add up: after a hundred metres the error is ten times that after one.
    """

    forward: float = 0.05
    """Metres after one metre, along the path."""

    sideways: float = 0.03
    """Metres after one metre, across it."""

    heading: float = 0.01
    """Radians after one metre."""

    turning: float = 0.05
    """Radians after one radian turned."""

    resting_m: float = 0.01
    """Metres after one second, also at rest."""

    resting_rad: float = 0.002
    """Radians after one second, also at rest."""

    scale: float = 0.05
    """Systematic relative error of the odometry's distances."""

    turn_scale: float = 0.1
    """Systematic relative error of its turns."""

    curve: float = 0.01
    """Systematic turn that the odometry does not measure, radians a metre."""

    velocity: float = 3.0
    """Metres a second along each axis, of a moving robot without odometry."""

    memory_s: float = 20.0
    """Time constant with which the velocity is forgotten, without odometry."""


Prediction = tuple[Floats, Floats, Floats]
"""The state (8,), its Jacobian by the previous state (8, 8), and the process noise covariance (8, 8)."""


def predict(state: Floats, move: Floats, *, seconds: float, noise: Noise) -> Prediction:
    """Predict the state at the next node.

    Args:
        state: (8,) float64
        move: (3,) float64. As in `Steps.moves`; NaN where it is unknown.
        seconds: Positive.
    """
    if math.isnan(move[0]):
        return _coast(state, seconds, noise)
    return _drive(state, move.tolist(), seconds=seconds, noise=noise)


def _drive(state: Floats, move: list[float], *, seconds: float, noise: Noise) -> Prediction:
    forward, right, turn = move
    scale = 1.0 + state[SCALE]
    # the unmeasured turn is spread evenly over the step: the chord is rotated by half of it
    excess = state[TURN_SCALE] * turn + state[CURVE] * forward
    angle = state[HEADING] + excess / 2
    sine, cosine = math.sin(angle), math.cos(angle)
    east = scale * (forward * sine + right * cosine)
    north = scale * (forward * cosine - right * sine)

    after = state.copy()
    after[0] += east
    after[1] += north
    after[2], after[3] = east / seconds, north / seconds
    after[HEADING] += turn + excess

    change = np.eye(SIZE)
    for row, moved, by_angle in ((0, east, north), (1, north, -east)):
        change[row, HEADING] = by_angle
        change[row, SCALE] = moved / scale
        change[row, TURN_SCALE] = by_angle * turn / 2
        change[row, CURVE] = by_angle * forward / 2
        change[row + 2] = change[row] / seconds
        change[row + 2, row] = 0.0  # the velocity does not depend on the position before
    change[HEADING, TURN_SCALE] = turn
    change[HEADING, CURVE] = forward
    return after, change, _drive_noise(move, (sine, cosine), seconds=seconds, noise=noise)


def _drive_noise(
    move: list[float], direction: tuple[float, float], *, seconds: float, noise: Noise
) -> Floats:
    way, turn = math.hypot(move[0], move[1]), abs(move[2])
    sine, cosine = direction
    along = noise.forward**2 * way + noise.resting_m**2 * seconds
    across = noise.sideways**2 * way + noise.resting_m**2 * seconds
    added = np.zeros((SIZE, SIZE))
    added[0, 0] = along * sine**2 + across * cosine**2
    added[1, 1] = along * cosine**2 + across * sine**2
    added[0, 1] = added[1, 0] = (along - across) * sine * cosine
    added[2, 2] = added[3, 3] = 0.1**2  # speed varies within a step
    added[HEADING, HEADING] = (
        noise.heading**2 * way + noise.turning**2 * turn + noise.resting_rad**2 * seconds
    )
    return added


def _coast(state: Floats, seconds: float, noise: Noise) -> Prediction:
    memory, variance = noise.memory_s, noise.velocity**2
    kept = math.exp(-seconds / memory)
    reach = memory * (1.0 - kept)
    change = np.eye(SIZE)
    added = np.zeros((SIZE, SIZE))
    position = variance * memory**2 * (2 * seconds / memory - 3 + 4 * kept - kept**2)
    for row in (0, 1):
        change[row, row + 2] = reach
        change[row + 2, row + 2] = kept
        added[row, row] = position + noise.resting_m**2 * seconds
        added[row + 2, row + 2] = variance * (1.0 - kept**2)
        added[row, row + 2] = added[row + 2, row] = variance * memory * (1.0 - kept) ** 2
    return change @ state, change, added
