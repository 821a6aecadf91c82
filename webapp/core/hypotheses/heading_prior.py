"""Headings of hypotheses: relative to north, and what a compass says about them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from webapp.core.geo.georeference import Georeference
from webapp.core.hypotheses.bayes import reweight
from webapp.core.hypotheses.model import Answer, Hypothesis

_SPREAD_DEG = 25.0
"""Of a hand-held compass near steel and electronics, and of headings that were computed."""

_OF_PHOTO_DEG = 40.0
"""Spread of a query about the heading of a photo that it is matched with: both see the same thing."""

_ASTRAY = 0.1
"""Share of compass readings that say nothing: disturbed, or of the phone and not of its camera."""


def relative_to_north(answer: Answer, georeference: Georeference | None) -> Answer:
    """Turn headings that count from image-up into headings from north; without a georeference up is north.

    Where the image is nowhere on the Earth there is no heading.
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
    """Weigh the hypotheses of an answer with a compass heading, by Bayes' rule.

    The reading is normal about the true heading, and anything in a tenth of the cases. What has no heading,
    "not on this map" among it, could look anywhere.

    Parameters
    ----------
    heading_deg : float
        Degrees clockwise from north.
    looked_deg : mapping of int to float
        Headings of the map's photos, by id, as far as they are known: used where a hypothesis
        has no heading itself.

    Returns
    -------
    Answer
        Its probabilities add up to 1 again; hypotheses are ranked by them.
    """
    return reweight(answer, [_likelihood(h, heading_deg, looked_deg) for h in answer.hypotheses])


def _likelihood(hypothesis: Hypothesis, compass_deg: float, looked_deg: Mapping[int, float]) -> float:
    """Density of the reading over that of a reading that may be anything."""
    heading, spread = hypothesis.heading_deg, _SPREAD_DEG
    if heading is None and hypothesis.experiences:
        heading, spread = looked_deg.get(hypothesis.experiences[0]), math.hypot(_SPREAD_DEG, _OF_PHOTO_DEG)
    if heading is None:
        return 1.0
    off = math.remainder(heading - compass_deg, 360.0)
    density = math.exp(-0.5 * (off / spread) ** 2) / (math.sqrt(2.0 * math.pi) * spread)
    return _ASTRAY + (1.0 - _ASTRAY) * 360.0 * density
