"""One answer from several photos of one spot.

Each photo's probabilities are a belief about the same place; the joint belief is their mean (a linear
opinion pool: Stone, "The opinion pool", 1961). It adds up to 1, a place that several photos name rises above
those that only one names, and it is never surer than the surest photo: photos of one spot err together, so
that multiplying their odds would claim too much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics


@dataclass(slots=True, eq=False)
class _Spot:
    """Hypotheses about one place, the most probable first."""

    members: list[Hypothesis] = field(default_factory=list)

    @property
    def lead(self) -> Hypothesis:
        return self.members[0]


def join(answers: Sequence[Answer], *, place_radius_px: float, top: int) -> Answer:
    """Join the answers about photos that were taken at one spot.

    Parameters
    ----------
    answers : sequence of Answer
        At least one, all by one method.
    place_radius_px : float
        Hypotheses nearer than this to a more probable one are about the same place.
    top : int
        At most so many hypotheses.

    Returns
    -------
    Answer
        Its headings and evidence are those of the photo that is surest about the first place: photos of one
        spot look in several directions.
    """
    if len(answers) == 1:
        return answers[0]
    count = len(answers)
    spots = _spots([h for a in answers for h in a.hypotheses], place_radius_px)
    joined = sorted((_joined(spot, count) for spot in spots), key=lambda h: -h.probability)
    cut = sum(h.probability for h in joined[top:])
    off = [a.off_map_probability for a in answers if a.off_map_probability is not None]
    best = _surest(answers, joined)
    return Answer(
        hypotheses=tuple(replace(h, rank=rank) for rank, h in enumerate(joined[:top], 1)),
        off_map_probability=sum(off) / count if len(off) == count else None,
        other_probability=sum(a.other_probability for a in answers) / count + cut,
        no_pose=None if joined else answers[0].no_pose,
        statistics=_statistics([a.statistics for a in answers]),
        evidence=best.evidence,
        seconds={stage: sum(a.seconds.get(stage, 0.0) for a in answers) for stage in answers[0].seconds},
        fov=best.fov,
    )


def surest(answers: Sequence[Answer], joint: Answer) -> int:
    """Tell which of the photos is the surest about the first place of the joint answer."""
    best = _surest(answers, joint.hypotheses)
    return next(n for n, answer in enumerate(answers) if answer is best)


def _spots(hypotheses: Sequence[Hypothesis], radius: float) -> list[_Spot]:
    spots: list[_Spot] = []
    for hypothesis in sorted(hypotheses, key=lambda h: -h.probability):
        near = (s for s in spots if math.dist(s.lead.position, hypothesis.position) <= radius)
        spot = next(near, None)
        if spot is None:
            spot = _Spot()
            spots.append(spot)
        spot.members.append(hypothesis)
    return spots


def _joined(spot: _Spot, photos: int) -> Hypothesis:
    """Average the positions that were computed, the precise ones more; else take the surest as it is."""
    computed = [h for h in spot.members if h.kind == "position" and h.radius_px]
    lead = max(computed, key=lambda h: h.probability, default=spot.lead)
    position = lead.position
    if computed:
        weights = [h.probability / (h.radius_px or 1.0) ** 2 for h in computed]
        mean = [
            sum(w * h.position[axis] for w, h in zip(weights, computed, strict=True)) / sum(weights)
            for axis in (0, 1)
        ]
        position = MapPixel(*mean)
    return replace(
        lead,
        position=position,
        probability=sum(h.probability for h in spot.members) / photos,
        experiences=tuple(dict.fromkeys(id for h in spot.members for id in h.experiences)),
        matches=sum(h.matches for h in spot.members),
    )


def _surest(answers: Sequence[Answer], joined: Sequence[Hypothesis]) -> Answer:
    if not joined:
        return answers[0]
    first = set(joined[0].experiences)

    def sure(answer: Answer) -> float:
        return max((h.probability for h in answer.hypotheses if first & set(h.experiences)), default=-1.0)

    return max(answers, key=sure)


def _statistics(parts: Sequence[MatchStatistics]) -> MatchStatistics:
    known = [p for p in parts if p.matches]
    matches, total = sum(p.matches for p in known), sum(p.distance_total or 0.0 for p in known)
    return MatchStatistics(
        keypoints=sum(p.keypoints for p in parts),
        matches=matches,
        matches_pruned=sum(p.matches_pruned for p in parts),
        distance_min=min((p.distance_min for p in known if p.distance_min is not None), default=None),
        distance_max=max((p.distance_max for p in known if p.distance_max is not None), default=None),
        distance_mean=total / matches if matches else None,
        distance_total=total if matches else None,
    )
