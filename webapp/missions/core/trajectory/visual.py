"""A localized photo as a fix: a position with its covariance in metres, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import is_off_map

CLEARLY = 0.7
"""Least probability of a place for a fix: a filter takes one position, not several candidates."""

AXIS_OF_RADIUS = 1.0 / math.sqrt(-2.0 * math.log(1.0 - 0.68))
"""Standard deviation along one axis over the 68 % radius of a normal distribution in the plane."""


@dataclass(frozen=True, slots=True)
class VisualFix:
    """A position fix from a localized photo."""

    latlon: LatLon
    covariance_m2: tuple[float, float, float]  # Variance east, variance north, and the covariance of both
    heading_deg: float | None  # Viewing direction, clockwise from north


def visual_fix(answer: Mapping[str, Any], georeference: Georeference | None) -> VisualFix | NoPose:
    """Convert an answer to a fix, if one place is clearly the most probable.

    Args:
        answer: In the format of `localize --json`.
        georeference: Of the map of the answer.
    """
    if answer.get("verdict") == "nothing_to_see":
        return NoPose("the photo has nothing to recognise", blank=True)
    best = next(iter(answer["hypotheses"]), None)
    if best is None or is_off_map(best["probability"], answer["off_map_probability"]):
        return NoPose("the photo was probably not taken on this map")
    if best["probability"] < CLEARLY:
        return NoPose(
            f"no place is clearly the right one: the best has a probability of {best['probability']:.2f}"
        )
    if best["lat"] is None or georeference is None:
        return NoPose("the map has no georeference")
    if best["radius_px"] is None:
        return NoPose("the accuracy of the position is not known")
    pixels = georeference.jacobian(MapPixel(best["x_px"], best["y_px"]))
    spread = pixels * (best["radius_px"] * AXIS_OF_RADIUS)
    covariance = spread @ spread.T
    if not np.isfinite(covariance).all():
        return NoPose("the map has no scale at that place")
    (east, both), (_, north) = covariance.tolist()
    return VisualFix(LatLon(best["lat"], best["lon"]), (east, north, both), best["heading_deg"])
