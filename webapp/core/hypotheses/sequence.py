"""One belief from the frames of a sequence: each frame's answer updates the belief of the frame before.

Where the camera is, if a frame has named the place, is estimated by a Gaussian-sum filter (Alspach and
Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", 1972). Its state is a Gaussian
mixture over position and velocity, plus the probability of being lost: at a place that no frame has named.
A frame's answer is read as a likelihood: its hypotheses as Gaussians of their radius, and that none of them
is right as the probability of a missed detection, which spares components that the frame does not see. New
components are spawned from the lost state, so that a robot that was carried elsewhere (the kidnapped robot)
is found again after some frames, and one outlier frame is not believed.

Whether a frame has named the place at all, and whether the camera is on the map, are other questions: frames
of one foreign scene name the same wrong places again and again, and a course on which they agree proves
nothing. So only what each frame itself says of it counts, and fades: a hundred frames that do not know weigh
as much as the last few of them.

The filter is causal. `smooth` also uses later frames: it combines the filter with one that runs backwards
(Fraser and Potter, "The optimum linear smoother as a combination of two optimum linear filters", 1969).
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
from webapp.core.hypotheses.mixture import (
    Component,
    kalman_update,
    merge,
    predict,
    reverse_time,
    should_merge,
    spawn,
)
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.hypotheses.path_prior import INSIDE_68, PathPrior, apply_path_prior, fit_path_prior

Array = NDArray[np.float64]

DEFAULT_SPEED = 1.0
"""Usual way from a frame to the next at most, place radii: else frames have little in common."""

_KIDNAPPED = 0.01
"""Chance, each frame, that the camera is elsewhere than motion can explain: carried, cut, or walked off."""

_TEMPER = 0.5
"""Power of a frame's likelihood after the first frame: neighbouring frames see the same and err together."""

_DOOR = 2.0
"""Spread of wrong answers that name a place near the right one, place radii."""

_ERR_TOGETHER = 0.5
"""Least 68 % radius, place radii: the error that neighbouring frames have in common."""

_FADES = 0.8
"""Power to which the odds of a named place, and of being off the map, are taken from frame to frame."""

_LEAST = 0.001
"""No frame is so sure of either, or of the contrary."""

_TRACKS, _LEAST_WEIGHT = 40, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class MotionModel:
    """What is known of map and camera.

    Attributes
    ----------
    speed_px : float
        About how far the camera comes from a frame to the next, map pixels.
    """

    paths: PathPrior
    speed_px: float

    @property
    def place_radius_px(self) -> float:
        """How far off a right hypothesis may be."""
        return self.paths.place_radius_px


@dataclass(frozen=True, slots=True)
class Belief:
    """Where the camera is, after some frames.

    Attributes
    ----------
    lost : float
        Probability of none of them, for the filter; with their weights it adds up to 1.
    frames : int
        How many it has seen.
    named, off : float
        Odds that one of them is right, and of being off the map.
    """

    components: tuple[Component, ...] = ()
    lost: float = 1.0
    frames: int = 0
    named: float = 1.0
    off: float = 1.0


def motion_model(position: Array, *, place_radius_px: float, speed_px: float | None = None) -> MotionModel:
    """Describe the motion over a map.

    Parameters
    ----------
    position : (p, 2) float64
        Of the map's photos, map pixels.
    speed_px : float, optional
        Usual way from a frame to the next; without it, the place radius.
    """
    return motion_model_on(fit_path_prior(position, place_radius_px=place_radius_px), speed_px=speed_px)


def motion_model_on(paths: PathPrior, *, speed_px: float | None = None) -> MotionModel:
    """Describe the motion over a map whose paths are known; otherwise as `motion_of`."""
    return MotionModel(paths, DEFAULT_SPEED * paths.place_radius_px if speed_px is None else speed_px)


def filter_step(
    belief: Belief, answer: Answer, *, motion: MotionModel, top: int, steps: float = 1.0
) -> tuple[Belief, Answer]:
    """Take in the answer about the next frame.

    Parameters
    ----------
    belief : Belief
        `Belief()` before the first frame.
    answer : Answer
        About this frame alone.
    top : int
        Maximum number of hypotheses.
    steps : float
        Time since the frame before, in usual frame intervals.

    Returns
    -------
    answer : Answer
        About this frame, by it and all before. Statistics and seconds are the frame's own.
    """
    predicted = _predict(belief, motion, steps)
    temper = 1.0 if belief.frames == 0 else _TEMPER
    updated = _reduce(_update(predicted, answer, motion=motion, temper=temper))
    return updated, _answer(updated, answer, motion=motion, top=top)


def smooth(
    answers: Sequence[Answer], *, motion: MotionModel, top: int, steps: Sequence[float] | None = None
) -> list[Answer]:
    """Answer about each frame of a sequence from all frames, those after it too.

    Parameters
    ----------
    answers : sequence of Answer
        About each frame alone, in the order in which they were taken.
    steps : sequence of float, optional
        Time of each frame since the one before, in usual frame intervals; the first one means nothing.

    Returns
    -------
    list of Answer
        One a frame, as by `follow`.
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
    """Join the belief up to a frame with that of a backward filter after it: a place both hold is likely."""
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
    """Weigh each course with each hypothesis, and with none of them.

    The likelihood of a position is, over that of knowing nothing, the sum of the hypotheses' Gaussians over
    the density of positions, and the chance that none is right; to the power `temper`, term by term.
    """
    hypotheses, miss = split_missed(answer)
    if not hypotheses:  # a dark or blurred frame says nothing
        return replace(belief, frames=belief.frames + 1)
    # Half of what may be is on the map, as for the photos that the probabilities were calibrated on.
    density = 0.5 / motion.paths.area_px2
    missed = miss**temper
    wide = (_DOOR * motion.place_radius_px) ** 2
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
                continue  # by stairs a camera comes from nowhere
            components.append(kalman_update(component, hypothesis, mass=mass, variance=variance / temper))
            components.append(kalman_update(component, hypothesis, mass=loose, variance=wide / temper))
    total = belief.lost * missed + sum(component.weight for component in components)
    whole = tuple(replace(component, weight=component.weight / total) for component in components)
    named, off = _frame_odds(answer, miss=miss)
    return Belief(
        whole,
        belief.lost * missed / total,
        belief.frames + 1,
        belief.named**_FADES * named**temper,
        belief.off**_FADES * off**temper,
    )


def _frame_odds(answer: Answer, *, miss: float) -> tuple[float, float]:
    """Return the odds that a hypothesis of a frame is right, if it is on the map, and of being off it."""
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
    return (max(radius, _ERR_TOGETHER * motion.place_radius_px) / INSIDE_68) ** 2


def _reduce(belief: Belief) -> Belief:
    """Merge components that are alike, the heaviest first, and drop those that hardly weigh."""
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
    """Make one hypothesis of components within one place, the heaviest first."""
    whole = merge(near)
    spread = (_ERR_TOGETHER * motion.place_radius_px / INSIDE_68) ** 2
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
        # Of what lies inside, as ever: given that the place is right.
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
    """Read what `belief_to_json` made.

    Raises
    ------
    KeyError, TypeError
        It is something else.
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
