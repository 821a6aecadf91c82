"""Bayes' rule on answers: reweight hypotheses by other knowledge than the photo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from webapp.core.hypotheses.model import Answer, Hypothesis

_LEAST_MISS = 0.02
"""Minimum probability that none of a photo's hypotheses is right."""

_UNKNOWN_MISS = 0.5
"""Probability that none is right, for methods that do not estimate it."""

_NOTHING = 1e-12
"""Hypotheses less probable than this are ignored."""


NEARBY_SHARE = 0.5
"""Share of wrong answers on the map that name a place near the right one, or one that looks like it."""


def reweight(answer: Answer, likelihood: Sequence[float]) -> Answer:
    """Reweight the hypotheses of an answer.

    Args:
        likelihood: Likelihood of an observation given each hypothesis, relative to its average over all
            places.

    Returns:
        Its probabilities add up to 1 again; hypotheses are ranked by them. The odds between places that were
            cut and "not on this map" do not change. Observations often fit wrong hypotheses, too, because
            these are near the truth: therefore the odds of a single hypothesis against none being right at
            most double.
    """
    listed = sum(h.probability for h in answer.hypotheses)
    if not listed:
        return answer
    usual = sum(h.probability * w for h, w in zip(answer.hypotheses, likelihood, strict=True)) / listed
    likelihood = [w / (1.0 - NEARBY_SHARE + NEARBY_SHARE * usual) for w in likelihood]
    grown = [h.probability * w for h, w in zip(answer.hypotheses, likelihood, strict=True)]
    total = sum(grown) + answer.other_probability + (answer.off_map_probability or 0.0)
    changed = [replace(h, probability=p / total) for h, p in zip(answer.hypotheses, grown, strict=True)]
    off = answer.off_map_probability
    weighed = replace(
        answer,
        other_probability=answer.other_probability / total,
        off_map_probability=None if off is None else off / total,
    )
    return rerank(weighed, changed)


def rerank(answer: Answer, hypotheses: Sequence[Hypothesis]) -> Answer:
    """Replace an answer's hypotheses, the most probable first; the evidence of the first comes first."""
    order = sorted(hypotheses, key=lambda h: -h.probability)
    first = set(order[0].experiences) if order else set()
    return replace(
        answer,
        hypotheses=tuple(replace(h, rank=rank) for rank, h in enumerate(order, 1)),
        evidence=tuple(sorted(answer.evidence, key=lambda e: e.experience not in first)),
    )


def truncate(answer: Answer, top: int) -> Answer:
    """Keep the first `top` hypotheses and their evidence; the rest is added to `other_probability`."""
    kept, cut = answer.hypotheses[:top], answer.hypotheses[top:]
    if not cut:
        return answer
    known = {id for h in kept for id in h.experiences}
    return replace(
        answer,
        hypotheses=kept,
        other_probability=answer.other_probability + sum(h.probability for h in cut),
        evidence=tuple(e for e in answer.evidence if e.experience in known),
    )


def split_missed(answer: Answer) -> tuple[list[Hypothesis], float]:
    """Return hypotheses and the probability that none is right, normalised to a sum of 1."""
    given = [h for h in answer.hypotheses if h.probability > _NOTHING]
    listed, off = sum(h.probability for h in given), answer.off_map_probability
    if not listed:
        return [], 1.0
    right = listed * (1.0 - _UNKNOWN_MISS) / (listed + answer.other_probability) if off is None else listed
    right = min(right, 1.0 - _LEAST_MISS)
    return [replace(h, probability=h.probability * right / listed) for h in given], 1.0 - right
