"""Headings of hypotheses: conversion to north, and weighting by a compass reading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from webapp.core.geo.georeference import Georeference
from webapp.core.hypotheses.bayes import reweight
from webapp.core.hypotheses.model import Answer, Hypothesis

_SPREAD_DEG = 25.0
"""Standard deviation of a hand-held compass near steel and electronics against a computed heading."""

_OF_PHOTO_DEG = 40.0
"""Standard deviation of a query's heading about that of a matched photo, which sees the same scene."""

_OUTLIER_SHARE = 0.1
"""Share of compass readings without information: disturbed, or of the phone and not of its camera."""


def relative_to_north(answer: Answer, georeference: Georeference | None) -> Answer:
    """Convert headings from image-up to headings from north; without a georeference up is north.

    A heading becomes None where the georeference is undefined.
    """
    if georeference is None:
        return answer
    turned = tuple(_from_north(h, georeference) for h in answer.hypotheses)
    return replace(answer, hypotheses=turned)


def _from_north(hypothesis: Hypothesis, georeference: Georeference) -> Hypothesis:
    if hypothesis.heading_deg is None:
        return hypothesis
    heading = hypothesis.heading_deg - georeference.north_deg(hypothesis.position)
    return replace(hypothesis, heading_deg=heading % 360.0 if math.isfinite(heading) else None)


def apply_compass(
    answer: Answer, heading_deg: float, *, looked_deg: Mapping[int, float] = MappingProxyType({})
) -> Answer:
    """Reweight the hypotheses of an answer by a compass heading.

    The reading is normally distributed about the true heading, or in a tenth of the cases uniform. It is
    uniform, too, for hypotheses without a heading and for "not on this map".

    Args:
        heading_deg: Degrees clockwise from north.
        looked_deg: Known headings of the map's photos, by id: used for hypotheses without a heading.

    Returns:
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    return reweight(answer, [_likelihood(h, heading_deg, looked_deg) for h in answer.hypotheses])


def _likelihood(hypothesis: Hypothesis, compass_deg: float, looked_deg: Mapping[int, float]) -> float:
    """Compute the density of the reading relative to a uniform one."""
    heading, spread = hypothesis.heading_deg, _SPREAD_DEG
    if heading is None and hypothesis.experiences:
        heading, spread = looked_deg.get(hypothesis.experiences[0]), math.hypot(_SPREAD_DEG, _OF_PHOTO_DEG)
    if heading is None:
        return 1.0
    off = math.remainder(heading - compass_deg, 360.0)
    density = math.exp(-0.5 * (off / spread) ** 2) / (math.sqrt(2.0 * math.pi) * spread)
    return _OUTLIER_SHARE + (1.0 - _OUTLIER_SHARE) * 360.0 * density
