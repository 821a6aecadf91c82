"""The estimated and the true poses of an evaluation as trajectories."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from webapp.core.evaluation.metrics import QueryResult
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Map
from webapp.files.exchange.tum import PlanarPose

_Sight = tuple[int, MapPixel, float | None]


@dataclass(frozen=True, slots=True)
class Trajectories:
    """Estimated and true poses, with the number of the query as timestamp."""

    estimate: list[PlanarPose]  # Poses of the first hypotheses; queries without one are left out
    truth: list[PlanarPose]
    frame: str  # Description of axes and units, for people


def trajectories(results: Iterable[QueryResult], themap: Map) -> Trajectories:
    """Convert the first hypotheses and the truth to a common frame.

    With a georeference: metres east (x) and north (y) of the first true position; without one: map pixels, x
    to the right and y down. Yaw is from x towards y in both.
    """
    found: list[_Sight] = []
    true: list[_Sight] = []
    for number, result in enumerate(results):
        true.append((number, result.truth, result.truth_heading_deg))
        hypotheses = () if result.answer is None else result.answer.hypotheses[:1]
        found.extend((number, first.position, first.heading_deg) for first in hypotheses)
    if themap.georeference is None:
        frame = "map pixels: x to the right, y down; yaw from x towards y"
        return Trajectories([_in_pixels(s) for s in found], [_in_pixels(s) for s in true], frame)
    origins = [themap.georeference.latlon_of(position) for _, position, _ in true]
    origin = next((one for one in origins if math.isfinite(one.lat)), None)
    if origin is None:
        return Trajectories([], [], "no query has a place on the ground")
    local = LocalFrame(origin)
    frame = f"metres east (x) and north (y) of {origin.lat:.8f}, {origin.lon:.8f}; yaw from x towards y"
    return Trajectories(
        _in_metres(found, themap.georeference, local), _in_metres(true, themap.georeference, local), frame
    )


def _in_pixels(sight: _Sight) -> PlanarPose:
    number, position, heading = sight
    yaw = None if heading is None else math.radians(heading - 90)
    return PlanarPose(float(number), position.x, position.y, yaw)


def _in_metres(sights: list[_Sight], georeference: Georeference, local: LocalFrame) -> list[PlanarPose]:
    places = georeference.enu_from_pixel([position for _, position, _ in sights], local)
    poses = []
    for (number, _, heading), (east, north) in zip(sights, places, strict=True):
        # A position beyond the horizon of a tilted image has no coordinates on the ground.
        if math.isfinite(east):
            yaw = None if heading is None else math.radians(90 - heading)
            poses.append(PlanarPose(float(number), float(east), float(north), yaw))
    return poses
