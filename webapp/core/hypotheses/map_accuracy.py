"""Limit to accuracy: no position is better than those of the photos that it is computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from statistics import median

from webapp.core.hypotheses.model import Answer, Hypothesis


def limit_accuracy(answer: Answer, position_radius_px: Mapping[int, float]) -> Answer:
    """Widen the radii of hypotheses to the median radius of their photos' positions.

    Photos placed by the GPS of one phone on one walk may all be off in the same direction, so that the mean
    of several is not better than each.

    Args:
        position_radius_px: 68 % radii of the positions of experiences, by id; all other positions are exact.
    """
    if not position_radius_px:
        return answer
    return replace(answer, hypotheses=tuple(_limited(h, position_radius_px) for h in answer.hypotheses))


def _limited(hypothesis: Hypothesis, position_radius_px: Mapping[int, float]) -> Hypothesis:
    if hypothesis.radius_px is None or not hypothesis.experiences:
        return hypothesis
    least = median(position_radius_px.get(id, 0.0) for id in hypothesis.experiences)
    return replace(hypothesis, radius_px=max(hypothesis.radius_px, least))
