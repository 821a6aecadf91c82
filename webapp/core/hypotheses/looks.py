"""One answer from several looks at one photo, each with other features.

Each look gives a place odds against "not on this map". Which look is more reliable differs from map to map,
so their odds are combined by a second calibrated softmax (stacked generalization, Wolpert 1992), fitted on
the trials that the looks themselves are calibrated on. A look's evidence for a place is
log(1 + odds / trace): zero if it does not name the place, and otherwise about the log-odds above those of a
mere trace, so that weak evidence keeps its order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.hypotheses.bayes import rerank, truncate
from webapp.core.hypotheses.calibration import Calibration, probabilities
from webapp.core.hypotheses.joint import cluster, fuse
from webapp.core.hypotheses.model import Answer, Hypothesis

LOOKS = 2

_TRACE = 0.03
"""Odds below which evidence counts as hardly any."""

DEFAULT = Calibration(slope=(0.8, 1.0), offset=-5.6, radius_scale=1.0)
"""Fitted on the queries of maps of several kinds, each left out in turn: the values differ little."""

CERTAIN = 0.9
"""Probability of the first hypothesis from which on no further look is needed."""

_MUCH_LESS = 0.1
"""Hypotheses about a place that are less probable than this share of the best do not affect its position."""

_LARGEST = 1e12
"""Upper limit of the odds; hypotheses less probable than its reciprocal are ignored."""


def is_certain(answer: Answer) -> bool:
    """Check whether an answer needs no further look."""
    return bool(answer.hypotheses) and answer.hypotheses[0].probability >= CERTAIN


def evidence_of_looks(
    looks: Sequence[Sequence[Hypothesis]], off_map: Sequence[float], *, radius_px: float
) -> tuple[list[list[tuple[int, Hypothesis]]], NDArray[np.float64]]:
    """Collect the evidence of the looks for each place.

    Args:
        looks: All hypotheses of each look.
        off_map: Each look's probability of "not on this map".
        radius_px: Hypotheses within this distance are one place.

    Returns:
        places: Hypotheses about each place with the numbers of their looks, the most probable first.
        evidence: (h, LOOKS) float64
    """
    named = [(n, h) for n, look in enumerate(looks) for h in look if h.probability > 1.0 / _LARGEST]
    spots = cluster(named, radius_px)
    evidence = np.zeros((len(spots), LOOKS))
    for spot, row in zip(spots, evidence, strict=True):
        for n, hypothesis in spot.members:
            odds = hypothesis.probability / max(off_map[n], hypothesis.probability / _LARGEST)
            row[n] = max(row[n], math.log1p(odds / _TRACE))
    return [spot.members for spot in spots], evidence


def fuse_place(
    place: Sequence[tuple[int, Hypothesis]], *, probability: float, place_radius_px: float
) -> Hypothesis:
    """Fuse the hypotheses about a place, as from `evidence_of_looks`.

    Computed positions are preferred to photos' places, and averaged. Hypotheses that are much less probable
    than the best have no effect on that.
    """
    believed = [h for _, h in place if h.probability >= _MUCH_LESS * place[0][1].probability]
    kind = "position" if any(h.kind == "position" for h in believed) else believed[0].kind
    members = [h for h in believed if h.kind == kind]
    fused = fuse(members, probability=probability, place_radius_px=place_radius_px)
    return replace(fused, experiences=tuple(dict.fromkeys(id for _, h in place for id in h.experiences)))


def combine_looks(
    answers: Sequence[Answer], *, calibration: Calibration, place_radius_px: float, top: int
) -> Answer:
    """Combine all looks at one photo.

    Args:
        answers: `LOOKS` of them, with all their hypotheses.
        calibration: Calibration of the combination: a slope for each look.
        top: Maximum number of hypotheses.

    Returns:
        Statistics are those of the look that is most certain of the first place; its evidence comes first.
    """
    off_map = [a.off_map_probability or 0.0 for a in answers]
    places, evidence = evidence_of_looks([a.hypotheses for a in answers], off_map, radius_px=place_radius_px)
    probability, off = probabilities(evidence, calibration)
    order = np.argsort(-probability, kind="stable")
    fused = [
        fuse_place(places[n], probability=float(probability[n]), place_radius_px=place_radius_px)
        for n in order
    ]
    if not fused:
        return _no_place(answers)
    best = answers[places[order[0]][0][0]]
    shown = {e.experience for e in best.evidence}
    further = (e for a in answers for e in a.evidence if e.experience not in shown)
    whole = replace(
        best,
        off_map_probability=off,
        other_probability=0.0,
        no_pose=None,
        evidence=(*best.evidence, *further),
        looks=tuple(name for a in answers for name in a.looks),
        seconds=_total_seconds(answers),
    )
    return truncate(rerank(whole, fused), top)


def _no_place(answers: Sequence[Answer]) -> Answer:
    """Return the first look that saw something but no place; if none saw anything, the first one."""
    seen = [a for a in answers if a.no_pose is None or not a.no_pose.blank]
    looks = tuple(name for a in answers for name in a.looks)
    return replace((*seen, *answers)[0], looks=looks, seconds=_total_seconds(answers))


def _total_seconds(answers: Sequence[Answer]) -> dict[str, float]:
    stages = dict.fromkeys(stage for a in answers for stage in a.seconds)
    return {stage: sum(a.seconds.get(stage, 0.0) for a in answers) for stage in stages}
