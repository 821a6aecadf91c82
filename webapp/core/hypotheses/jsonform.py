"""JSON form of an answer, shared by the command line and the web API."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, AnswerSource, CameraPose, Hypothesis, MatchStatistics
from webapp.core.hypotheses.verdict import sentence_of, verdict_of

STAGES = ("read", "extract", "retrieve", "verify", "position", "total")
"""Names of the times in `seconds`, in order of execution."""


def answer_to_json(answer: Answer, *, query: str, source: AnswerSource) -> dict[str, Any]:
    """Make the object that `localize --json` prints for one photo.

    Args:
        query: Name of the photo, as given.

    Returns:
        Plain values only; None if unknown.
    """
    return {
        "query": query,
        "method": source.method,
        "features": source.features,
        "fov_deg": None if answer.fov is None else answer.fov.degrees,
        "fov_source": None if answer.fov is None else answer.fov.source,
        "verdict": verdict_of(answer),
        "sentence": sentence_of(answer),
        "hypotheses": [_hypothesis(h, source) for h in answer.hypotheses],
        "other_probability": answer.other_probability,
        "off_map_probability": answer.off_map_probability,
        "statistics": asdict(answer.statistics),
        **({"no_pose": answer.no_pose.reason} if answer.no_pose is not None else {}),
        "seconds": {stage: answer.seconds.get(stage) for stage in STAGES},
        "map_revision": source.map_revision,
        "map_kind": source.map_kind,
        "place_radius_px": source.place_radius_px,
        "looks": list(answer.looks),
        **({"sequence": True} if source.sequence else {}),
        **({"note": answer.note} if answer.note else {}),
    }


def answer_from_json(form: Mapping[str, Any]) -> Answer:
    """Parse the output of `answer_to_json`, as far as it is drawn on maps: without the matches."""
    hypotheses = tuple(
        Hypothesis(
            rank,
            h.get("kind", "position"),
            MapPixel(h["x_px"], h["y_px"]),
            probability=h["probability"],
            radius_px=h.get("radius_px"),
            heading_deg=h.get("heading_deg"),
            experiences=tuple(h.get("experiences", ())),
            inliers=h.get("inliers"),
            matches=h.get("matches", 0),
            floor=h.get("floor", BASE_FLOOR),
        )
        for rank, h in enumerate(form["hypotheses"], 1)
    )
    return Answer(
        hypotheses,
        form.get("off_map_probability"),
        form.get("other_probability", 0.0),
        no_pose=None if hypotheses else _no_pose(form),
        statistics=MatchStatistics(0, 0, 0, None, None, None, None),
    )


def _no_pose(form: Mapping[str, Any]) -> NoPose:
    return NoPose(form.get("no_pose", "no match on this map"), blank=form.get("verdict") == "nothing_to_see")


def failure_to_json(*, query: str, error: str) -> dict[str, Any]:
    """Make the object that `localize --json` prints for a photo that could not be used."""
    return {"query": query, "error": error}


def _hypothesis(hypothesis: Hypothesis, source: AnswerSource) -> dict[str, Any]:
    lat = lon = radius_m = None
    georeference = source.georeference
    if georeference is not None:
        lat, lon = (_known(v) for v in georeference.latlon_of(hypothesis.position))
        if lat is not None and hypothesis.radius_px is not None:
            radius_m = _known(hypothesis.radius_px * georeference.metres_per_pixel(hypothesis.position))
    return {
        "rank": hypothesis.rank,
        "kind": hypothesis.kind,
        "x_px": float(hypothesis.position.x),
        "y_px": float(hypothesis.position.y),
        "radius_px": hypothesis.radius_px,
        "heading_deg": hypothesis.heading_deg,
        "lat": lat,
        "lon": lon,
        "radius_m": radius_m,
        "probability": hypothesis.probability,
        "experiences": list(hypothesis.experiences),
        "inliers": hypothesis.inliers,
        "matches": hypothesis.matches,
        **_floor(hypothesis.floor, source.floors),
        **(
            {}
            if hypothesis.camera is None
            else {"camera": _camera(hypothesis.camera, hypothesis.position, georeference)}
        ),
    }


def _floor(id: int, floors: tuple[Floor, ...]) -> dict[str, Any]:
    """Return id, name and height of a place's floor; empty if the map does not list it."""
    found = next((floor for floor in floors if floor.id == id), None)
    if found is None:
        return {}
    return {"floor": id, "floor_name": found.name, "floor_height_m": found.height_m}


def _camera(camera: CameraPose, at: MapPixel, georeference: Georeference | None) -> dict[str, Any]:
    metres = None if georeference is None else _known(georeference.metres_per_pixel(at))
    return {
        "height_px": camera.height_px,
        "height_m": None if metres is None else metres * camera.height_px,
        "pitch_deg": camera.pitch_deg,
        "roll_deg": camera.roll_deg,
        "covariance": camera.covariance.tolist(),
        "landmarks": camera.landmarks,
    }


def _known(value: float) -> float | None:
    """Convert undefined values of the geometry, which are not finite, to None: null in JSON."""
    return value if math.isfinite(value) else None
