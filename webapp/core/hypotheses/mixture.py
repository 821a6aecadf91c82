"""Gaussian mixture over the position and velocity of a camera.

Both axes are independent and have the same covariance, so that a component needs three numbers for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Hypothesis

_MEMORY = 100.0
"""Correlation time of the velocity, frames; per frame it changes by about a seventh of the usual speed."""

_ALIKE = 1.0
"""Components nearer to each other than this, in standard deviations, are merged."""


@dataclass(frozen=True, slots=True)
class Component:
    """One component of the mixture."""

    weight: float  # Probability
    # `x`, `y`: Position and velocity, map pixels and map pixels per frame.
    x: tuple[float, float]
    y: tuple[float, float]
    # (3,) float. Variance of position, covariance of position and velocity, variance of velocity; for both
    # axes.
    covariance: tuple[float, float, float]
    hypothesis: Hypothesis  # The latest one that supported it
    seen: bool  # Whether that was in the latest frame

    @property
    def spread(self) -> float:
        """Standard deviation of the position along an axis, map pixels."""
        return math.sqrt(self.covariance[0])

    @property
    def position(self) -> MapPixel:
        return MapPixel(self.x[0], self.y[0])


def spawn(hypothesis: Hypothesis, *, weight: float, variance: float, speed_px: float) -> Component:
    """Create a component at a hypothesis, with unknown velocity."""
    x, y = hypothesis.position
    covariance = (variance, 0.0, speed_px**2 / 2.0)
    return Component(weight, (float(x), 0.0), (float(y), 0.0), covariance, hypothesis, seen=True)


def predict(component: Component, *, speed_px: float, steps: float) -> Component:
    """Predict a component some frames ahead.

    The velocity is an Ornstein-Uhlenbeck process: nearly constant, yet bounded after a gap of any length.

    Args:
        speed_px: Root mean square of the speed, map pixels per frame.
    """
    rate = 1.0 / _MEMORY
    fade = math.exp(-rate * steps)
    reach = (1.0 - fade) / rate
    variance = speed_px**2 / 2.0
    wander = variance / rate**2 * (2.0 * rate * steps - 3.0 + 4.0 * fade - fade**2)
    pp, pv, vv = component.covariance
    covariance = (
        pp + 2.0 * reach * pv + reach**2 * vv + wander,
        fade * (pv + reach * vv) + variance / rate * (1.0 - fade) ** 2,
        fade**2 * vv + variance * (1.0 - fade**2),
    )
    x, y = ((p + reach * v, fade * v) for p, v in (component.x, component.y))
    return replace(component, x=x, y=y, covariance=covariance, seen=False)


def reverse_time(component: Component) -> Component:
    """Reverse the direction of time."""
    (x, right), (y, down), (pp, pv, vv) = component.x, component.y, component.covariance
    return replace(component, x=(x, -right), y=(y, -down), covariance=(pp, -pv, vv))


def kalman_update(component: Component, hypothesis: Hypothesis, *, mass: float, variance: float) -> Component:
    """Update a component with a hypothesis (Kalman filter).

    Args:
        mass: Integral of its likelihood, map pixels squared; it and the predicted density multiply the
            weight.
        variance: Variance of its position along an axis, map pixels squared.
    """
    pp, pv, vv = component.covariance
    total = pp + variance
    off = [at - state[0] for at, state in zip(hypothesis.position, (component.x, component.y), strict=True)]
    foreseen = math.exp(-0.5 * (off[0] ** 2 + off[1] ** 2) / total) / (2.0 * math.pi * total)
    gain, turn = pp / total, pv / total
    x, y = ((s[0] + gain * o, s[1] + turn * o) for s, o in zip((component.x, component.y), off, strict=True))
    covariance = (pp * (1.0 - gain), pv * (1.0 - gain), vv - turn * pv)
    return Component(component.weight * mass * foreseen, x, y, covariance, hypothesis, seen=True)


def should_merge(a: Component, b: Component) -> bool:
    """Decide whether two components should be merged; the first is the heavier one."""
    return a.hypothesis.floor == b.hypothesis.floor and _distance(a, b) <= _ALIKE


def merge(components: Sequence[Component]) -> Component:
    """Merge components, the heaviest first, into one.

    Mean and covariance are those of their sum; the hypothesis is that of the heaviest one that was seen.
    """
    if len(components) == 1:
        return components[0]
    weight = sum(t.weight for t in components)
    share = np.array([t.weight / weight for t in components])
    state = np.array([(t.x, t.y) for t in components])  # (n, axis, position or velocity)
    mean = np.einsum("n,nas->as", share, state)
    off = state - mean
    spread = np.einsum("n,nas,nau->su", share, off, off) / 2.0
    covariance = share @ np.array([t.covariance for t in components])
    lead = next((t for t in components if t.seen), components[0])
    return Component(
        weight,
        (float(mean[0, 0]), float(mean[0, 1])),
        (float(mean[1, 0]), float(mean[1, 1])),
        (
            float(covariance[0] + spread[0, 0]),
            float(covariance[1] + spread[0, 1]),
            float(covariance[2] + spread[1, 1]),
        ),
        lead.hypothesis,
        lead.seen,
    )


def _distance(a: Component, b: Component) -> float:
    """Compute the Mahalanobis distance of two components by the covariance of the first, the heavier one."""
    pp, pv, vv = a.covariance
    squared = 0.0
    for p, q in ((a.x, b.x), (a.y, b.y)):
        d, e = q[0] - p[0], q[1] - p[1]
        squared += (vv * d * d - 2.0 * pv * d * e + pp * e * e) / (pp * vv - pv * pv)
    return math.sqrt(max(squared, 0.0))
