"""One answer from several photos of one spot.

Each photo's probabilities, divided by the prior, measure its support for each place; the odds of independent
photos would multiply (naive Bayes). Photos of one spot have correlated errors, so that for each place the
photo with the strongest support counts fully and each further one half. A photo that does not name a place
counts slightly against it; a photo that names none, e.g. a dark one, is ignored.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.bayes import rerank, split_missed, truncate
from webapp.core.hypotheses.model import Answer, Hypothesis, MatchStatistics
from webapp.core.hypotheses.priors import PathPrior

_FURTHER_WEIGHT = 0.5
"""Weight of each photo other than the one with the strongest support."""

_NOT_NAMED = -0.5
"""Log likelihood ratio of a place that a photo does not name; small, as mapped places are often missed."""

_LEAST_RADIUS = 0.5
"""Added in quadrature to the radii by which positions are weighted, place radii: errors are correlated."""


@dataclass(slots=True, eq=False)
class PlaceCluster:
    """Hypotheses about one place, the most probable first, each with the number of its photo."""

    members: list[tuple[int, Hypothesis]] = field(default_factory=list)

    @property
    def lead(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.members[0][1]


def combine(answers: Sequence[Answer], *, paths: PathPrior, top: int) -> Answer:
    """Combine the answers about photos taken at one spot.

    Args:
        answers: At least one, all by the same method.
        paths: Paths of the map.
        top: Maximum number of hypotheses.

    Returns:
        The evidence is that of the photo that is most certain of the first place. Each heading is that of the
            most probable hypothesis about the place, since photos of one spot look in several directions.
    """
    if len(answers) == 1:
        return truncate(answers[0], top)
    read = [split_missed(answer) for answer in answers]
    spots = cluster([(n, h) for n, (given, _) in enumerate(read) for h in given], paths.place_radius_px)
    missed = {n: miss for n, (given, miss) in enumerate(read) if given}
    odds = np.array([_log_odds(spot, missed, expected=-math.log(paths.places)) for spot in spots])
    most = max(float(odds.max(initial=0.0)), 0.0)
    grown, none = np.exp(odds - most), math.exp(-most)
    share = grown / (grown.sum() + none)
    none /= float(grown.sum()) + none
    known = [a.off_map_probability for a in answers if a.off_map_probability is not None]
    joined = [
        fuse([h for _, h in spot.members], probability=float(p), place_radius_px=paths.place_radius_px)
        for spot, p in zip(spots, share, strict=True)
    ]
    best = answers[most_confident(answers, sorted(joined, key=lambda h: -h.probability))]
    off = len(known) == len(answers)
    whole = replace(
        best,
        off_map_probability=none if off else None,
        other_probability=0.0 if off else none,
        no_pose=None if joined else answers[0].no_pose,
        statistics=_statistics([a.statistics for a in answers]),
        seconds={stage: sum(a.seconds.get(stage, 0.0) for a in answers) for stage in answers[0].seconds},
    )
    return truncate(rerank(whole, joined), top)


def most_confident(answers: Sequence[Answer], joined: Sequence[Hypothesis]) -> int:
    """Return the index of the answer that is most certain of the first of the sorted joint hypotheses."""
    if not joined:
        return 0
    first = set(joined[0].experiences)

    def sure(answer: Answer) -> float:
        return max((h.probability for h in answer.hypotheses if first & set(h.experiences)), default=-1.0)

    return max(range(len(answers)), key=lambda n: sure(answers[n]))


def with_evidence_of(joint: Answer, one: Answer) -> Answer:
    """Return a joint answer with one photo's evidence: priors applied to it can change the best photo."""
    return rerank(replace(joint, evidence=one.evidence, fov=one.fov, looks=one.looks), joint.hypotheses)


def cluster(hypotheses: Sequence[tuple[int, Hypothesis]], radius_px: float) -> list[PlaceCluster]:
    """Group hypotheses, each with the number of its photo or look, by place; the most probable first."""
    spots: list[PlaceCluster] = []
    for number, hypothesis in sorted(hypotheses, key=lambda pair: -pair[1].probability):
        near = (
            s
            for s in spots
            if s.lead.floor == hypothesis.floor
            and math.dist(s.lead.position, hypothesis.position) <= radius_px
        )
        spot = next(near, None)
        if spot is None:
            spot = PlaceCluster()
            spots.append(spot)
        spot.members.append((number, hypothesis))
    return spots


def _log_odds(spot: PlaceCluster, missed: Mapping[int, float], *, expected: float) -> float:
    """Compute the log-odds of a place against no place being right.

    Args:
        missed: For each photo with hypotheses, the probability that none of them is right.
        expected: Prior log-odds of a place.
    """
    says = []
    for number, miss in missed.items():
        named = sum(h.probability for n, h in spot.members if n == number)
        says.append(math.log(named / miss) - expected if named else _NOT_NAMED)
    first, *further = sorted(says, reverse=True)
    return expected + first + _FURTHER_WEIGHT * sum(max(s, _NOT_NAMED) for s in further)


def fuse(members: Sequence[Hypothesis], *, probability: float, place_radius_px: float) -> Hypothesis:
    """Average positions, computed ones if any, by probability and precision; heading is the best one's."""
    computed = [h for h in members if h.kind == "position"] or members
    least = _LEAST_RADIUS * place_radius_px
    squared = [(h.radius_px or place_radius_px) ** 2 + least**2 for h in computed]
    weight = [h.probability / s for h, s in zip(computed, squared, strict=True)]
    mean = np.average([h.position for h in computed], axis=0, weights=weight)
    radius = float(np.average([h.radius_px or 0.0 for h in computed], weights=weight))
    return replace(
        computed[0],
        position=MapPixel(*mean.tolist()),
        probability=probability,
        radius_px=radius or None,
        experiences=tuple(dict.fromkeys(id for h in members for id in h.experiences)),
        matches=sum(h.matches for h in members),
    )


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
