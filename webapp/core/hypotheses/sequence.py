"""Filter a sequence of frames: each frame's answer updates the belief from the frames before it.

The position, given that some frame has named the place, is estimated by a Gaussian-sum filter (Alspach and
Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", 1972). Its state is a Gaussian
mixture over position and velocity, plus the probability of being lost: at a place that no frame has named.
A frame's answer is converted to a likelihood: each hypothesis is a Gaussian with the width of its radius, and
the probability that none is right is that of a missed detection, which preserves components that the frame
does not support. New components are spawned from the lost state, so that a robot that was carried elsewhere
(the kidnapped robot) is found again after some frames, and a single outlier frame is not believed.

Two more probabilities are estimated separately: that any frame has named the place at all, and that the
camera is off the map. Frames of one foreign scene name the same wrong places again and again, so a consistent
course is no evidence for either. Hence each frame contributes only its own odds, with exponential forgetting:
a hundred uninformative frames weigh as much as the last few of them.

The filter is causal. `smooth` also uses later frames: it combines the filter with one that runs backwards
(Fraser and Potter, "The optimum linear smoother as a combination of two optimum linear filters", 1969).

In the mixture both axes are independent and have the same covariance, so that a component needs three numbers
for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.bayes import NEARBY_SHARE, split_missed
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.hypotheses.priors import INSIDE_68, PathPrior, apply_path_prior

Array = NDArray[np.float64]

DEFAULT_SPEED = 1.0
"""Default distance between consecutive frames, place radii: frames farther apart have little in common."""

_KIDNAPPED = 0.01
"""Probability per frame of a jump beyond the motion model: carried elsewhere, a cut, or walked off."""

_TEMPER = 0.5
"""Exponent of a frame's likelihood after the first frame: neighbouring frames have correlated errors."""

_NEARBY_SPREAD = 2.0
"""Standard deviation of wrong answers that name a place near the right one, place radii."""

_COMMON_ERROR = 0.5
"""Minimum 68 % radius, place radii: the error that neighbouring frames have in common."""

_FORGETTING = 0.8
"""Exponent of the odds `named` and `off` from frame to frame: exponential forgetting."""

_LEAST = 0.001
"""A frame's probabilities are clipped to this distance from 0 and 1 before they become odds."""

_TRACKS, _LEAST_WEIGHT = 40, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class MotionModel:
    """Paths of the map and speed of the camera."""

    paths: PathPrior
    speed_px: float  # Typical distance that the camera moves between consecutive frames, map pixels

    @property
    def place_radius_px(self) -> float:
        """Distance within which a hypothesis counts as right."""
        return self.paths.place_radius_px


@dataclass(frozen=True, slots=True)
class Belief:
    """Estimate of the camera's position after some frames."""

    components: tuple[Component, ...] = ()
    # Probability, in the filter, that no component is right; it and their weights add up to 1.
    lost: float = 1.0
    frames: int = 0  # Number of frames so far
    # `named`, `off`: Odds that a component is right, and odds of being off the map.
    named: float = 1.0
    off: float = 1.0


def motion_model(paths: PathPrior, *, speed_px: float | None = None) -> MotionModel:
    """Build the motion model of a map with these paths.

    Args:
        speed_px: Typical distance between consecutive frames; by default the place radius.
    """
    return MotionModel(paths, DEFAULT_SPEED * paths.place_radius_px if speed_px is None else speed_px)


def filter_step(
    belief: Belief, answer: Answer, *, motion: MotionModel, top: int, steps: float = 1.0
) -> tuple[Belief, Answer]:
    """Update the belief with the answer about the next frame.

    Args:
        belief: `Belief()` before the first frame.
        answer: Answer about this frame alone.
        top: Maximum number of hypotheses.
        steps: Time since the frame before, in usual frame intervals.

    Returns:
        answer: Answer about this frame, from it and all earlier ones. Statistics and seconds are those of the
            frame.
    """
    predicted = _predict(belief, motion, steps)
    temper = 1.0 if belief.frames == 0 else _TEMPER
    updated = _reduce(_update(predicted, answer, motion=motion, temper=temper))
    return updated, _answer(updated, answer, motion=motion, top=top)


def smooth(
    answers: Sequence[Answer], *, motion: MotionModel, top: int, steps: Sequence[float] | None = None
) -> list[Answer]:
    """Compute an answer about each frame of a sequence from all frames, including later ones.

    Args:
        answers: Answers about each frame alone, in the order in which the frames were taken.
        steps: Time of each frame since the one before, in usual frame intervals; the first has no effect.

    Returns:
        One per frame, as from `filter_step`.
    """
    steps = steps or [1.0] * len(answers)
    before, after = Belief(), Belief()
    until = []
    for answer, step in zip(answers, steps, strict=True):
        before, _ = filter_step(before, answer, motion=motion, top=top, steps=step)
        until.append(before)
    smoothed = []
    for answer, belief, step in reversed(list(zip(answers, until, [*steps, 1.0][1:], strict=True))):
        later = _predict(after, motion, step)
        smoothed.append(_answer(_combine(belief, later, motion), answer, motion=motion, top=top))
        after, _ = filter_step(after, answer, motion=motion, top=top, steps=step)
    return smoothed[::-1]


def _combine(belief: Belief, later: Belief, motion: MotionModel) -> Belief:
    """Combine the forward belief up to a frame with the backward filter's belief from the frames after it."""
    if not later.frames:
        return belief
    density = 0.5 / motion.paths.area_px2
    components = [replace(t, weight=t.weight * later.lost) for t in belief.components]
    for component in later.components:
        there = replace(component.hypothesis, position=component.position)
        components.append(replace(reverse_time(component), weight=belief.lost * component.weight))
        for t in belief.components:
            if t.hypothesis.floor != component.hypothesis.floor:
                continue
            both = kalman_update(t, there, mass=component.weight / density, variance=component.covariance[0])
            components.append(replace(both, hypothesis=t.hypothesis, seen=t.seen))
    lost = belief.lost * later.lost
    total = lost + sum(t.weight for t in components)
    whole = tuple(replace(t, weight=t.weight / total) for t in components)
    odds = belief.named * later.named, belief.off * later.off
    return _reduce(Belief(whole, lost / total, belief.frames, *odds))


def _predict(belief: Belief, motion: MotionModel, steps: float) -> Belief:
    stay = (1.0 - _KIDNAPPED) ** steps
    components = [
        replace(predict(t, speed_px=motion.speed_px, steps=steps), weight=stay * t.weight)
        for t in belief.components
    ]
    return replace(belief, components=tuple(components), lost=1.0 - stay * (1.0 - belief.lost))


def _update(belief: Belief, answer: Answer, *, motion: MotionModel, temper: float) -> Belief:
    """Update each component with each hypothesis, and with a missed detection.

    The likelihood ratio of a position, against no information, is the sum of the hypotheses' Gaussians over
    the prior density of positions, plus the probability that none is right; each term to the power `temper`.
    """
    hypotheses, miss = split_missed(answer)
    if not hypotheses:  # a dark or blurred frame carries no information
        return replace(belief, frames=belief.frames + 1)
    # The prior probability of being on the map is one half, as for the photos used for calibration.
    density = 0.5 / motion.paths.area_px2
    missed = miss**temper
    wide = (_NEARBY_SPREAD * motion.place_radius_px) ** 2
    astray = (miss * (1.0 - NEARBY_SHARE)) ** temper
    components = [replace(component, weight=component.weight * astray) for component in belief.components]
    for hypothesis in hypotheses:
        variance = _variance(hypothesis, motion)
        mass = _mass(hypothesis.probability, variance, density=density, temper=temper)
        fresh = belief.lost * mass * density
        components.append(spawn(hypothesis, weight=fresh, variance=variance, speed_px=motion.speed_px))
        near = NEARBY_SHARE * miss * hypothesis.probability / sum(h.probability for h in hypotheses)
        loose = _mass(near, wide, density=density, temper=temper)
        for component in belief.components:
            if component.hypothesis.floor != hypothesis.floor:
                continue  # after a change of floor the camera is a new component
            components.append(kalman_update(component, hypothesis, mass=mass, variance=variance / temper))
            components.append(kalman_update(component, hypothesis, mass=loose, variance=wide / temper))
    total = belief.lost * missed + sum(component.weight for component in components)
    whole = tuple(replace(component, weight=component.weight / total) for component in components)
    named, off = _frame_odds(answer, miss=miss)
    return Belief(
        whole,
        belief.lost * missed / total,
        belief.frames + 1,
        belief.named**_FORGETTING * named**temper,
        belief.off**_FORGETTING * off**temper,
    )


def _frame_odds(answer: Answer, *, miss: float) -> tuple[float, float]:
    """Return a frame's odds that a hypothesis is right, given that it is on the map, and of being off it."""
    off, other = answer.off_map_probability, answer.other_probability
    off = 0.0 if off is None or off + other <= 0.0 else miss * off / (off + other)
    return _odds((1.0 - miss) / (1.0 - off)), _odds(off)


def _odds(probability: float) -> float:
    probability = min(max(probability, _LEAST), 1.0 - _LEAST)
    return probability / (1.0 - probability)


def _mass(probability: float, variance: float, *, density: float, temper: float) -> float:
    """Integrate a Gaussian likelihood, relative to `density`, to the power `temper`; map pixels squared."""
    peak = probability / (2.0 * math.pi * variance * density)
    return float(peak**temper * 2.0 * math.pi * variance / temper)


def _variance(hypothesis: Hypothesis, motion: MotionModel) -> float:
    radius = motion.place_radius_px if hypothesis.radius_px is None else hypothesis.radius_px
    return (max(radius, _COMMON_ERROR * motion.place_radius_px) / INSIDE_68) ** 2


def _reduce(belief: Belief) -> Belief:
    """Merge similar components, the heaviest first, and drop those of little weight."""
    left = sorted((t for t in belief.components if t.weight >= _LEAST_WEIGHT), key=lambda t: -t.weight)
    merged = []
    while left:
        lead = left[0]
        merged.append(merge([t for t in left if should_merge(lead, t)]))
        left = [t for t in left if not should_merge(lead, t)]
    kept = sorted(merged, key=lambda t: -t.weight)[:_TRACKS]
    return replace(belief, components=tuple(kept), lost=max(0.0, 1.0 - sum(t.weight for t in kept)))


def _answer(belief: Belief, frame: Answer, *, motion: MotionModel, top: int) -> Answer:
    """Convert the belief to an answer about the frame."""
    radius = motion.place_radius_px
    off = belief.off / (1.0 + belief.off)
    share = (1.0 - off) * belief.named / (1.0 + belief.named)
    share /= max(sum(t.weight for t in belief.components), 1e-300)
    left, places = [replace(t, weight=share * t.weight) for t in belief.components], []
    while left:
        near = [t for t in left if _is_near(t, left[0], radius)]
        left = [t for t in left if not _is_near(t, left[0], radius)]
        places.append(_place(near, motion))
    ranked = sorted(places, key=lambda h: -h.probability)[:top]
    listed = sum(h.probability for h in ranked)
    known = frame.off_map_probability is not None
    off = min(off, 1.0 - listed)
    first = set(ranked[0].experiences) if ranked else set()
    return replace(
        frame,
        hypotheses=tuple(replace(h, rank=rank) for rank, h in enumerate(ranked, 1)),
        off_map_probability=off if known else None,
        other_probability=max(0.0, 1.0 - listed - (off if known else 0.0)),
        no_pose=None if ranked else frame.no_pose,
        evidence=tuple(sorted(frame.evidence, key=lambda e: e.experience not in first)),
    )


def _is_near(one: Component, other: Component, radius_px: float) -> bool:
    same = one.hypothesis.floor == other.hypothesis.floor
    return same and math.dist(one.position, other.position) <= radius_px


def _place(near: Sequence[Component], motion: MotionModel) -> Hypothesis:
    """Convert the components within one place, the heaviest first, to one hypothesis."""
    whole = merge(near)
    spread = (_COMMON_ERROR * motion.place_radius_px / INSIDE_68) ** 2
    position, by_axis = apply_path_prior(
        whole.position,
        whole.covariance[0] + spread,
        paths=motion.paths,
        floor=whole.hypothesis.floor,
    )
    variance = float(by_axis.mean())
    inside = 1.0 - math.exp(-0.5 * motion.place_radius_px**2 / variance)
    of_frame = whole.hypothesis
    return replace(
        of_frame,
        kind="position",
        position=position,
        probability=whole.weight * inside,
        # radius of 68 % of the mass inside the place radius: it is given that the place is right
        radius_px=math.sqrt(-2.0 * variance * math.log(1.0 - 0.68 * inside)),
        heading_deg=of_frame.heading_deg if whole.seen else None,
        inliers=of_frame.inliers if whole.seen else None,
        matches=of_frame.matches if whole.seen else 0,
    )


def belief_to_json(belief: Belief) -> dict[str, Any]:
    """Convert a belief to plain values; its components are named `tracks`, as in stored sequences."""
    return {
        "tracks": [asdict(component) for component in belief.components],
        "lost": belief.lost,
        "frames": belief.frames,
        "named": belief.named,
        "off": belief.off,
    }


def belief_from_json(form: dict[str, Any]) -> Belief:
    """Parse the output of `belief_to_json`.

    Raises:
        KeyError, TypeError: The values have another form.
    """
    numbers = (float(form[name]) for name in ("named", "off"))
    components = tuple(_component(t) for t in form["tracks"])
    return Belief(components, float(form["lost"]), int(form["frames"]), *numbers)


def _component(form: dict[str, Any]) -> Component:
    hypothesis = dict(form["hypothesis"])
    hypothesis["position"] = MapPixel(*hypothesis["position"])
    hypothesis["experiences"] = tuple(hypothesis["experiences"])
    plain = {name: tuple(form[name]) for name in ("x", "y", "covariance")}
    return Component(weight=form["weight"], hypothesis=Hypothesis(**hypothesis), seen=form["seen"], **plain)


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
