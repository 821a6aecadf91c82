"""One answer from those with several focal lengths, where the query's is a guess.

A photo without EXIF may be cropped. With a focal length that is too short, the camera seems to stand closer
to what it shows than it did: a wrong place, of which the matches are as sure as of a right one. The answers
are therefore averaged (Bayesian model averaging): each focal length counts by its prior times its total odds
of the places, so that what only one of them says is less probable, and what all say is not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.bayes import rerank
from webapp.core.hypotheses.model import Answer, Hypothesis

CROPPED_TO = (0.7, 0.5)
"""Shares of the guessed width that cropped photos show."""

_CROPPED = 0.03
"""Prior probability of each. With 0.2 more crops are right, but by night fewer photos that are whole."""

_LEAST = 1e-12


def narrower(fov_deg: float) -> tuple[float, ...]:
    """Return the fields of view of photos that are cropped to `CROPPED_TO`."""
    half = math.tan(math.radians(fov_deg) / 2.0)
    return tuple(math.degrees(2.0 * math.atan(share * half)) for share in CROPPED_TO)


def average(whole: Answer, cropped: Sequence[Answer], *, place_radius_px: float) -> Answer:
    """Average the answers with the guessed focal length and with those of cropped photos.

    Args:
        whole, cropped: With all their hypotheses, none of them cut; each estimates "not on this map".
    """
    answers = [whole, *cropped]
    off = np.array([answer.off_map_probability or 0.0 for answer in answers])
    odds = np.array([1.0 - _CROPPED * len(cropped), *(_CROPPED for _ in cropped)]) / np.maximum(off, _LEAST)
    share = odds / odds.sum()
    found: dict[tuple[int, str, MapPixel], Hypothesis] = {}
    for answer, weight in zip(answers, share.tolist(), strict=True):
        for h in answer.hypotheses:
            key = h.floor, h.kind, h.position
            known = found[key].probability if key in found else 0.0
            found[key] = replace(h, probability=known + weight * h.probability)
    lead, *others = sorted(found.values(), key=lambda h: -h.probability)
    same = [h for h in others if _is_same(lead, h, place_radius_px)]
    rest = [h for h in others if h not in same]
    joined = replace(answers[int(share.argmax())], off_map_probability=float(share @ off))
    return rerank(joined, [_joined([lead, *same]), *rest])


def _is_same(first: Hypothesis, other: Hypothesis, radius_px: float) -> bool:
    """Check whether two hypotheses are estimates of one place from the same photos."""
    near = first.floor == other.floor and math.dist(first.position, other.position) <= radius_px
    return near and bool(set(first.experiences) & set(other.experiences))


def _joined(same: Sequence[Hypothesis]) -> Hypothesis:
    """Join estimates of one place: the position is the most probable, the radius contains the others."""
    first = same[0]
    probability = sum(h.probability for h in same)
    estimates = [h for h in same if h.kind == first.kind]
    if first.radius_px is None:
        return replace(first, probability=probability)
    squared = [
        (h.radius_px or first.radius_px) ** 2 + math.dist(h.position, first.position) ** 2 for h in estimates
    ]
    weight = [h.probability for h in estimates]
    return replace(
        first,
        probability=probability,
        radius_px=math.sqrt(float(np.average(squared, weights=weight))),
    )
