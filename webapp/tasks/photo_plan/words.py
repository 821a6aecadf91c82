"""Converts a plan of photos to words, and to a walk for a phone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.photo_plan import Reason
from webapp.core.mapmodel.recognition import DIRECTIONS, STEP_DEG
from webapp.errors import UsageError
from webapp.files.exchange.walk import WalkPoint


@dataclass(frozen=True, slots=True)
class PlanWords:
    """The words of one language."""

    directions: tuple[str, ...]  # From north clockwise
    reasons: Mapping[Reason, str]
    look: str  # Template with `{directions}`
    look_around: str  # Used if no direction is planned


ENGLISH = PlanWords(
    ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"),
    {
        "not-recognised": "photos here were not recognised",
        "one-direction": "seen in one direction only",
        "direction": "no photo looks this way",
        "few-photos": "few photos near here",
    },
    "look {directions}",
    "look all around",
)


def direction_of(bearing_deg: float, words: PlanWords = ENGLISH) -> str:
    """Return the nearest of the eight directions, in words."""
    return words.directions[round(bearing_deg / STEP_DEG) % DIRECTIONS]


def directions_of(spot: Mapping[str, Any], words: PlanWords = ENGLISH) -> str:
    """Return in words where to look at a spot of `planning.plan_json`."""
    names = [direction_of(h, words) for h in spot["headings_deg"]]
    return words.look.format(directions=", ".join(names)) if names else words.look_around


def walk_of(plan: Mapping[str, Any], words: PlanWords = ENGLISH) -> list[WalkPoint]:
    """Convert a plan from `planning.plan_json` to a walk.

    Raises:
        UsageError: The map has no georeference.
    """
    spots = plan["spots"]
    if any(spot["lat"] is None for spot in spots):
        raise UsageError(
            "the spots have no latitude and longitude: the map has no georeference",
            hint="georeference the image: see docs/georeference.md",
        )
    width = len(str(len(spots)))
    return [
        WalkPoint(
            f"{spot['number']:0{width}}",
            _sentence(f"{directions_of(spot, words)}: {words.reasons[spot['reason']]}"),
            LatLon(spot["lat"], spot["lon"]),
            next(iter(spot["headings_deg"]), None),
        )
        for spot in spots
    ]


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]
