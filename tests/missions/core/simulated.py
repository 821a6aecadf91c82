"""Simulated drives of a robot: truth, odometry and measurements."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from webapp.missions.core.trajectory.motion import Noise
from webapp.missions.core.trajectory.steps import Fixes, Steps


@dataclass
class Drive:
    """A robot on a winding path at 1 m/s; its odometry has errors according to `noise`."""

    seed: int
    nodes: int = 240
    seconds: float = 0.5
    sigma_m: float = 2.0
    every: int = 4
    noise: Noise = field(default_factory=Noise)
    rate: Callable[[float], float] = lambda seconds: 0.15 * np.sin(seconds / 15)
    """Yaw rate, radians per second."""

    def __post_init__(self):
        self.rng = rng = np.random.default_rng(self.seed)
        noise, dt, n = self.noise, self.seconds, self.nodes
        scale, turns, curve = rng.normal(0, [noise.scale, noise.turn_scale, noise.curve])
        self.truth, self.heading = np.zeros((n, 2)), np.zeros(n)
        self.heading[0] = rng.uniform(-np.pi, np.pi)
        self.moves = np.full((n, 3), np.nan)
        for i in range(1, n):
            way, turn = 1.0 * dt, self.rate(i * dt) * dt
            self.moves[i] = way, 0.0, turn
            excess = turns * turn + curve * way
            angle = self.heading[i - 1] + excess / 2
            along = (1 + scale) * way + rng.normal(0, noise.forward * way**0.5)
            across = rng.normal(0, noise.sideways * way**0.5)
            forward, right = (
                np.array([np.sin(angle), np.cos(angle)]),
                np.array([np.cos(angle), -np.sin(angle)]),
            )
            rest = rng.normal(0, noise.resting_m * dt**0.5, 2)
            self.truth[i] = self.truth[i - 1] + along * forward + across * right + rest
            random = noise.heading**2 * way + noise.turning**2 * abs(turn) + noise.resting_rad**2 * dt
            self.heading[i] = self.heading[i - 1] + turn + excess + rng.normal(0, random**0.5)
        self.node = np.arange(0, n, self.every)
        self.measured = self.truth[self.node] + rng.normal(0, self.sigma_m, (len(self.node), 2))

    @property
    def steps(self):
        """Return the steps for the filter; the odometry assumes that it started towards north."""
        own = np.concatenate([[0.0], np.cumsum(self.moves[1:, 2])])
        return Steps(np.arange(self.nodes) * self.seconds, self.moves, own)

    @property
    def fixes(self):
        """Return the fixes for the filter."""
        m = len(self.node)
        return Fixes(self.node, self.measured, np.tile(np.eye(2) * self.sigma_m**2, (m, 1, 1)), np.ones(m))

    def reckoned(self):
        """Return the dead-reckoned positions from the true start pose, (n, 2)."""
        heading = self.heading[0] + np.concatenate([[0.0], np.cumsum(self.moves[1:, 2])])
        moved = self.moves[1:, :1] * np.column_stack([np.sin(heading), np.cos(heading)])[:-1]
        return np.vstack([np.zeros((1, 2)), np.cumsum(moved, axis=0)])


def rmse(positions, truth):
    """Return the root of the mean squared distance."""
    return float(np.sqrt(((positions - truth) ** 2).sum(axis=1).mean()))


def nees(smoothed, drive):
    """Return the squared Mahalanobis distance of the truth from the estimate, (n,)."""
    off = smoothed.state[:, :2] - drive.truth
    return np.einsum("ni,nij,nj->n", off, np.linalg.inv(smoothed.covariance[:, :2, :2]), off)
