"""Bayes' rule on answers: what is known besides the photo weighs its hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from webapp.core.hypotheses.model import Answer, Hypothesis

_LEAST_MISS = 0.02
"""No photo is so sure of its hypotheses that none could be right."""

_UNKNOWN_MISS = 0.5
"""The probability that none is right, for methods that do not estimate it."""

_NOTHING = 1e-12
"""A hypothesis is less probable than this only in name."""


NEARBY_SHARE = 0.5
"""Share of wrong answers on the map that name a place near the right one, or one that looks like it."""


def reweight(answer: Answer, likelihood: Sequence[float]) -> Answer:
    """Weigh the hypotheses of an answer.

    Parameters
    ----------
    likelihood : sequence of float
        Of what is known, given each hypothesis, over that given anything.

    Returns
    -------
    Answer
        Its probabilities add up to 1 again; hypotheses are ranked by them. Places that were cut, and
        "not on this map", keep their odds against each other. What is known often fits hypotheses that are
        wrong, too, because they are near the truth: so it can make a lone one at most twice
        as likely against that none is right.
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
    """Give an answer these hypotheses, the most probable first, and its evidence in their order."""
    order = sorted(hypotheses, key=lambda h: -h.probability)
    first = set(order[0].experiences) if order else set()
    return replace(
        answer,
        hypotheses=tuple(replace(h, rank=rank) for rank, h in enumerate(order, 1)),
        evidence=tuple(sorted(answer.evidence, key=lambda e: e.experience not in first)),
    )


def truncate(answer: Answer, top: int) -> Answer:
    """Cut all hypotheses but the first `top`, with their evidence; what they had is other places'."""
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
    """Normalize hypotheses and the probability that none is right, to a sum of 1."""
    given = [h for h in answer.hypotheses if h.probability > _NOTHING]
    listed, off = sum(h.probability for h in given), answer.off_map_probability
    if not listed:
        return [], 1.0
    right = listed * (1.0 - _UNKNOWN_MISS) / (listed + answer.other_probability) if off is None else listed
    right = min(right, 1.0 - _LEAST_MISS)
    return [replace(h, probability=h.probability * right / listed) for h in given], 1.0 - right
