"""Localizes photos of one spot together, with hints: their approximate position and compass heading.

A hint never excludes a place: the circle is a prior, the compass heading a likelihood. If all shortlisted
photos are outside the circle, the best photos within it are verified, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses import joint
from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.priors import (
    CirclePrior,
    apply_circle_prior,
    apply_compass,
    apply_path_prior_to_answer,
    photo_weights,
)
from webapp.errors import UsageError
from webapp.tasks.localize.pipeline import LocalizationPipeline

ALL = 100
"""Maximum number of hypotheses before the hints are applied; large enough to keep all places in practice."""


@dataclass(frozen=True, slots=True)
class Hints:
    """Hints about photos."""

    near: CirclePrior | None = None  # Approximate position
    heading_deg: float | None = None  # Heading of the camera, degrees clockwise from north


def combine(
    pipeline: LocalizationPipeline, answers: Sequence[Answer], *, hints: Hints, top: int
) -> tuple[Answer, int]:
    """Combine the answers about the photos with the hints.

    Args:
        answers: From `LocalizationPipeline.observe` with `top=ALL`, one per photo; at least one.
        top: Maximum number of hypotheses.

    Returns:
        best: Index of the photo whose evidence is used.
    """
    settled = _settled(pipeline, answers)
    if settled is not None:
        return truncate(answers[settled], top), settled
    weighed, best = combine_without_prior(pipeline, answers, hints=hints)
    paths = pipeline.opened.indexed.paths
    weight = None if hints.near is None else photo_weights(hints.near, paths)
    answer = truncate(apply_path_prior_to_answer(weighed, paths, weight=weight), top)
    return pipeline.limit_accuracy(answer), best


def combine_without_prior(
    pipeline: LocalizationPipeline, answers: Sequence[Answer], *, hints: Hints
) -> tuple[Answer, int]:
    """Combine all but the path prior on positions; a sequence has a prior of its own."""
    settled = _settled(pipeline, answers)
    if settled is not None:
        return answers[settled], settled
    paths = pipeline.opened.indexed.paths
    answer = joint.combine(answers, paths=paths, top=ALL)
    if hints.near is not None:
        answer = apply_circle_prior(answer, hints.near, paths=paths)
    if hints.heading_deg is not None:
        # A panorama matches photos of any heading.
        around = any(one.fov is not None and one.fov.degrees >= 360.0 for one in answers)
        looked_deg = {} if around else photo_headings(pipeline)
        answer = apply_compass(answer, hints.heading_deg, looked_deg=looked_deg)
    best = joint.most_confident(answers, answer.hypotheses)
    return joint.with_evidence_of(answer, answers[best]), best


def _settled(pipeline: LocalizationPipeline, answers: Sequence[Answer]) -> int | None:
    """Return the index of the most certain answer by tags, which no other photo or hint changes, if any."""
    by_tags = [n for n, answer in enumerate(answers) if answer.by_tags and answer.hypotheses]
    if not by_tags:
        return None if pipeline.looks else 0
    return max(by_tags, key=lambda n: answers[n].hypotheses[0].probability)


def photo_headings(pipeline: LocalizationPipeline) -> dict[int, float]:
    """Return the headings of the map's photos by id: the recorded one, else that of the orientation.

    Panoramas are left out, as they look in all directions.
    """
    indexed = pipeline.opened.indexed
    computed = zip(indexed.ids.tolist(), _from_north(pipeline).tolist(), strict=True)
    photos = [e for e in pipeline.map.experiences if e.panorama is None]
    own = {e.id: e.heading_deg for e in photos if e.heading_deg is not None}
    seen = {e.id for e in photos}
    return {id: deg for id, deg in computed if id in seen and not math.isnan(deg)} | own


def _from_north(pipeline: LocalizationPipeline) -> NDArray[np.float64]:
    """Compute the headings of the map's photos, degrees clockwise from north; NaN where unknown."""
    indexed, georeference = pipeline.opened.indexed, pipeline.map.georeference
    headings = indexed.image_headings_deg()
    if georeference is None:
        return headings
    norths = [georeference.north_deg(MapPixel(x, y)) for x, y in indexed.position.tolist()]
    turned: NDArray[np.float64] = (headings - np.array(norths)) % 360.0
    return turned


def photos_in(pipeline: LocalizationPipeline, near: CirclePrior | None) -> frozenset[int]:
    """Return the ids of the map's photos in a circle, or within a place radius of it.

    Raises:
        UsageError: There are none.
    """
    if near is None or not pipeline.looks:
        return frozenset()
    indexed = pipeline.opened.indexed
    far = near.radius + indexed.place_radius_px
    there = ((indexed.position - (near.x, near.y)) ** 2).sum(1) <= far**2
    if not there.any():
        raise UsageError(
            "no photo of the map is where the hint says",
            where="hint_radius_px",
            hint="make the circle larger, or leave the hint out",
        )
    return frozenset(indexed.ids[there].tolist())
