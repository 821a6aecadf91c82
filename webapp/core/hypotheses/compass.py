"""What a compass says about the hypotheses: their headings should agree with it."""

from __future__ import annotations

import math
from dataclasses import replace

from webapp.core.hypotheses.model import Answer

_SPREAD_DEG = 25.0
"""Of a hand-held compass beside steel and electronics, and of headings that were computed."""

_ASTRAY = 0.1
"""Share of compass readings that say nothing: disturbed, or of the phone and not of its camera."""


def with_heading(answer: Answer, heading_deg: float) -> Answer:
    """Weigh the hypotheses of an answer with a compass heading, by Bayes' rule.

    The reading is normal about the true heading, and anything in a tenth of the cases. What has no heading,
    "not on this map" among it, could look anywhere.

    Parameters
    ----------
    answer : Answer
    heading_deg : float
        Degrees clockwise from north.

    Returns
    -------
    Answer
        Its probabilities add up to 1 again; ranked anew.
    """
    weighed = [h.probability * _likelihood(h.heading_deg, heading_deg) for h in answer.hypotheses]
    total = sum(weighed) + answer.other_probability + (answer.off_map_probability or 0.0)
    if not total:
        return answer
    changed = [replace(h, probability=p / total) for h, p in zip(answer.hypotheses, weighed, strict=True)]
    ranked = sorted(changed, key=lambda h: -h.probability)
    first = set(ranked[0].experiences) if ranked else set()
    off = answer.off_map_probability
    return replace(
        answer,
        hypotheses=tuple(replace(h, rank=rank) for rank, h in enumerate(ranked, 1)),
        other_probability=answer.other_probability / total,
        off_map_probability=None if off is None else off / total,
        evidence=tuple(sorted(answer.evidence, key=lambda e: e.experience not in first)),
    )


def _likelihood(heading_deg: float | None, compass_deg: float) -> float:
    """Density of the reading over that of a reading that may be anything."""
    if heading_deg is None:
        return 1.0
    off = math.remainder(heading_deg - compass_deg, 360.0)
    density = math.exp(-0.5 * (off / _SPREAD_DEG) ** 2) / (math.sqrt(2.0 * math.pi) * _SPREAD_DEG)
    return _ASTRAY + (1.0 - _ASTRAY) * 360.0 * density
