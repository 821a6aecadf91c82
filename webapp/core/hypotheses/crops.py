"""One answer about a photo that may be a crop, from its answers for several fields of view.

Where the field of view is not known and nothing says that the photo is a whole one, it may be the middle of
one. With the wrong field of view fewer matches agree, so that the places lose odds: the answers are averaged
(Bayesian model averaging), each weighted by its prior and its odds against "not on this map". Where all these
odds are small they differ by chance, and the answer is that for the whole photo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.bayes import rerank
from webapp.core.hypotheses.joint import cluster
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.tuning import CropsTuning

_LEAST = 1e-9
"""Lower limit of probabilities whose logarithm is needed; hypotheses less probable are ignored."""


def average_answers(answers: Sequence[Answer], *, tuning: CropsTuning, place_radius_px: float) -> Answer:
    """Average the answers about one photo, as a whole and as each crop of `tuning.shares`.

    Args:
        answers: With all their hypotheses; the first is for the whole photo.

    Returns:
        Statistics, evidence and field of view are those of the answer with the largest weight.
    """
    odds = np.array([_odds(answer) for answer in answers])
    seconds = {stage: sum(a.seconds.get(stage, 0.0) for a in answers) for stage in answers[0].seconds}
    if odds.max() < tuning.min_odds:
        return replace(answers[0], seconds=seconds)
    weight = _weights(odds, tuning)
    named = [
        (n, replace(h, probability=float(weight[n]) * h.probability))
        for n, answer in enumerate(answers)
        for h in answer.hypotheses
        if weight[n] * h.probability > _LEAST
    ]
    spots = cluster(named, place_radius_px)
    best = answers[int(weight.argmax())]
    mean = replace(
        best,
        off_map_probability=float(weight @ [a.off_map_probability or 0.0 for a in answers]),
        other_probability=float(weight @ [a.other_probability for a in answers]),
        seconds=seconds,
    )
    return rerank(mean, [_mean([h for _, h in s.members], most_px=place_radius_px) for s in spots])


def _odds(answer: Answer) -> float:
    """Return the odds of all places together against "not on this map"."""
    off = min(max(answer.off_map_probability or 0.0, _LEAST), 1.0)
    return max(1.0 - off, _LEAST) / off


def _weights(odds: NDArray[np.float64], tuning: CropsTuning) -> NDArray[np.float64]:
    """Compute the posterior probability of each field of view."""
    prior = np.full(len(odds), tuning.prior)
    prior[0] = 1.0 - prior[1:].sum()
    weight: NDArray[np.float64] = prior * (odds / odds.max()) ** tuning.power
    weight /= weight.sum()
    return weight


def _mean(members: Sequence[Hypothesis], *, most_px: float) -> Hypothesis:
    """Average the hypotheses about a place, the most probable first; their scatter adds to the radius."""
    total = sum(h.probability for h in members)
    alike = [h for h in members if h.kind == members[0].kind]
    share = np.array([h.probability for h in alike]) / sum(h.probability for h in alike)
    at = np.array([h.position for h in alike])
    mean = share @ at
    squared = share @ (np.array([h.radius_px or 0.0 for h in alike]) ** 2 + ((at - mean) ** 2).sum(1))
    radius = min(math.sqrt(squared), most_px)
    return replace(
        members[0],
        position=MapPixel(*mean.tolist()),
        probability=min(total, 1.0),
        radius_px=None if members[0].radius_px is None else radius,
    )
