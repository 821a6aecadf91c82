"""Says where photos of one spot were taken, with what is known besides: about where, and looking where.

What is known never hides anything: it weighs what the photos say, as a prior (a circle) or as a likelihood (a
compass). Where all photos that look most alike are outside the circle, some within it are looked at, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from webapp.core.hypotheses import joint
from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.circle_prior import CirclePrior, apply_circle_prior, photo_weights
from webapp.core.hypotheses.heading_prior import apply_compass
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.path_prior import apply_path_prior_to_answer
from webapp.errors import UsageError
from webapp.tasks.localize.photo import PhotoLocalizer

_ALL = 100
"""Hypotheses before anything is weighed: more than any method has whose places are few."""


@dataclass(frozen=True, slots=True)
class Hints:
    """What is known of photos besides themselves.

    Attributes
    ----------
    near : Near or None
        About where they were taken.
    heading_deg : float or None
        Where the camera looked, degrees clockwise from north.
    """

    near: CirclePrior | None = None
    heading_deg: float | None = None


def look(localizer: PhotoLocalizer, photo: Path, *, hints: Hints) -> Answer:
    """Tell what one of the photos says by itself.

    Raises
    ------
    PhotoError
        It cannot be used.
    UsageError
        There is no photo of the map in the circle.
    """
    return localizer.look(photo, top=_ALL, closer=_within(localizer, hints.near))


def join(
    localizer: PhotoLocalizer, answers: Sequence[Answer], *, hints: Hints, top: int
) -> tuple[Answer, int]:
    """Join what the photos say with the hints.

    Parameters
    ----------
    localizer : PhotoLocalizer
    answers : sequence of Answer
        By `look`, one a photo; at least one.
    hints : Hints
    top : int
        At most so many hypotheses.

    Returns
    -------
    answer : Answer
    best : int
        Number of the photo that it takes heading and evidence from.
    """
    weighed, best = weigh(localizer, answers, hints=hints)
    paths = localizer.opened.indexed.paths
    weight = None if hints.near is None else photo_weights(hints.near, paths)
    return truncate(apply_path_prior_to_answer(weighed, paths, weight=weight), top), best


def weigh(localizer: PhotoLocalizer, answers: Sequence[Answer], *, hints: Hints) -> tuple[Answer, int]:
    """Do all of `join` but the prior over exact positions, which a sequence has its own of."""
    paths = localizer.opened.indexed.paths
    answer = joint.combine(answers, paths=paths, top=_ALL)
    if hints.near is not None:
        answer = apply_circle_prior(answer, hints.near, paths=paths)
    if hints.heading_deg is not None:
        answer = apply_compass(answer, hints.heading_deg, looked_deg=headings(localizer))
    best = joint.most_confident(answers, answer)
    return joint.with_evidence_of(answer, answers[best]), best


def headings(localizer: PhotoLocalizer) -> dict[int, float]:
    """Where photos of the map looked: as they say themselves, else as was worked out from what they see."""
    indexed = localizer.opened.indexed
    computed = zip(indexed.ids.tolist(), indexed.headings_deg().tolist(), strict=True)
    own = {e.id: e.heading_deg for e in localizer.map.experiences if e.heading_deg is not None}
    return {id: deg for id, deg in computed if not math.isnan(deg)} | own


def _within(localizer: PhotoLocalizer, near: CirclePrior | None) -> frozenset[int]:
    """Tell which photos of the map are in the circle, or so near to it that it may mean their place.

    Raises
    ------
    UsageError
        None is.
    """
    if near is None:
        return frozenset()
    indexed = localizer.opened.indexed
    far = near.radius + indexed.place_radius_px
    there = ((indexed.position - (near.x, near.y)) ** 2).sum(1) <= far**2
    if not there.any():
        raise UsageError(
            "no photo of the map is where the hint says",
            where="hint_radius_px",
            hint="make the circle larger, or leave the hint out",
        )
    return frozenset(indexed.ids[there].tolist())
