"""Detects photos of a map that are confusable, lonely, or at a place that is shown from one side only."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer
from webapp.core.mapmodel.model import Experience

State = Literal["confusable", "lonely", "one-direction", "good"]

_CONFIDENT = 0.5
_FAINT = 0.1
_ELSEWHERE = 2.0
"""Place radii beyond which a place is another one: near a hidden place, its neighbours are the answer."""

_ONE_SIDE_DEG = 120.0
"""Headings within such an angle show one side of a place only."""


@dataclass(frozen=True, slots=True)
class PhotoHealth:
    id: int
    # "confusable", "lonely", "one-direction" or "good". Confusable: localized at a wrong place with high
    # probability. Lonely: not recognised by any photo near it. One-direction: all photos of its place look to
    # one side.
    state: State
    taken_for: int | None = None  # The best-matching photo at the wrong place
    probability: float | None = None  # Of the wrong place


def judge(
    experiences: Sequence[Experience], answers: Mapping[int, Sequence[Answer]], *, place_radius_px: float
) -> list[PhotoHealth]:
    """Judge photos by their localization while they were hidden from the map.

    Args:
        answers: By id: first the answer with the photo itself hidden, then others with its whole place
            hidden.
    """
    judged = []
    for e in experiences:
        if e.id not in answers:
            continue
        wrong = _taken_for(e, answers[e.id], far_px=_ELSEWHERE * place_radius_px)
        if wrong is not None:
            judged.append(wrong)
        elif not _recognised(e, answers[e.id][0], near_px=_ELSEWHERE * place_radius_px):
            judged.append(PhotoHealth(e.id, "lonely"))
        elif _one_sided(e.position, experiences, radius_px=place_radius_px):
            judged.append(PhotoHealth(e.id, "one-direction"))
        else:
            judged.append(PhotoHealth(e.id, "good"))
    return judged


def widest_gap_deg(headings: Iterable[float]) -> float:
    """Return the largest angle between neighbouring headings, degrees; 360 for one heading or none."""
    around = sorted(heading % 360.0 for heading in headings)
    if not around:
        return 360.0
    return max((b - a for a, b in zip(around, [*around[1:], around[0] + 360.0], strict=True)), default=360.0)


def _taken_for(e: Experience, answers: Sequence[Answer], *, far_px: float) -> PhotoHealth | None:
    for answer in answers:
        best = answer.hypotheses[0] if answer.hypotheses else None
        if best is None or best.probability < _CONFIDENT or math.dist(best.position, e.position) <= far_px:
            continue
        other = best.experiences[0] if best.experiences else None
        return PhotoHealth(e.id, "confusable", other, best.probability)
    return None


def _recognised(e: Experience, answer: Answer, *, near_px: float) -> bool:
    return any(
        h.probability >= _FAINT and math.dist(h.position, e.position) <= near_px for h in answer.hypotheses
    )


def _one_sided(at: MapPixel, experiences: Sequence[Experience], *, radius_px: float) -> bool:
    """Return whether all known headings around a place look to one side; unknown ones are ignored."""
    headings = [
        e.heading_deg
        for e in experiences
        if e.heading_deg is not None and math.dist(e.position, at) <= radius_px
    ]
    return bool(headings) and widest_gap_deg(headings) > 360.0 - _ONE_SIDE_DEG
