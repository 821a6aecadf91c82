"""Plans where to take the next photos of a map, puts the plan into words, and adds the photos taken there."""

from __future__ import annotations

import json
import math
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.core.hypotheses.places import place_radius_px
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.photo_plan import PlannedSpot, Reason, plan_spots, walk_length
from webapp.core.mapmodel.recognition import (
    DIRECTIONS,
    STEP_DEG,
    PhotoTrials,
    RecognitionGrid,
    Rectangle,
    estimate_recognition,
)
from webapp.errors import StorageError, UsageError
from webapp.files.atomic import make_folder, write_text
from webapp.files.exchange.gpx import WalkPoint
from webapp.files.listing import DERIVED
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.evaluation import stored as stored_evaluation
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.place_rest import SuggestedPlace
from webapp.tasks.maps import health
from webapp.tasks.maps.add_photo import AddedPhoto, IncomingPhoto, add_photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.placing import needed_image

MOST_SPOTS = 100

TrialSource = Literal["evaluation", "health", "none"]
"""Source of trials: the evaluation of the map on itself, the survey of its weak places, or none."""

_FILE = "photo-plan.json"
_VERSION = 1
_RECOGNISED = frozenset({"good", "one-direction"})


class PhotoTrial(NamedTuple):
    """Result of the trials of a photo: share in which it was recognised, and its estimated heading."""

    success: float
    heading_deg: float | None = None


@dataclass(frozen=True, slots=True)
class MapTrials:
    source: TrialSource
    by_photo: Mapping[int, PhotoTrial]  # Trials by photo id


@dataclass(frozen=True, slots=True)
class PlanRequest:
    spots: int = 12
    area: Rectangle | None = None  # Area of the image, pixels; None plans where there are photos


@dataclass(frozen=True, slots=True, eq=False)
class PhotoPlan:
    """How well a map is recognised, and where to take the next photos."""

    map_: Map
    grid: RecognitionGrid
    trials: MapTrials
    spots: list[PlannedSpot]  # In map pixels; their `photos` are ids
    latlon: list[LatLon | None]  # Of the spots
    expected_share: float  # Recognised share of the area with the new photos, as predicted by the model
    walk_px: float
    scale: float | None  # Metres per pixel in the middle of the image


def plan_photos(map_: Map, *, trials: MapTrials, request: PlanRequest) -> PhotoPlan:
    """Plan the next photos.

    Raises:
        UsageError: The map has no placed photos, or the area is not on its image.
    """
    if not map_.experiences:
        raise UsageError("the map has no placed photos", hint="place some photos first")
    if not 1 <= request.spots <= MOST_SPOTS:
        raise UsageError(f"plan 1 to {MOST_SPOTS} spots", where="spots")
    image = Rectangle(0.0, 0.0, map_.satellite.width, map_.satellite.height)
    photos, ids = _photos(map_.experiences, trials.by_photo)
    radius = place_radius_px(photos.position, width=map_.satellite.width, height=map_.satellite.height)
    grid = estimate_recognition(photos, radius=radius, image=image, area=_on_image(request.area, image))
    if not grid.wanted.any():
        raise UsageError("the area is not on the image", where="area", hint="draw a larger one on the image")
    spots = [
        replace(spot, photos=tuple(dict.fromkeys(ids[n] for n in spot.photos)))
        for spot in plan_spots(grid, photos, count=request.spots)
    ]
    where = map_.georeference
    middle = MapPixel(map_.satellite.width / 2, map_.satellite.height / 2)
    return PhotoPlan(
        map_,
        grid,
        trials,
        spots,
        [None if where is None else where.latlon_of(MapPixel(*spot.position)) for spot in spots],
        grid.share + sum(spot.gain for spot in spots),
        walk_length(np.array([spot.position for spot in spots]).reshape(-1, 2)),
        None if where is None else where.metres_per_pixel(middle),
    )


def trials_of(map_: Map, cfg: Path) -> MapTrials:
    """Return the trials of the last evaluation of a map on itself, else of the last survey of weak places.

    Raises StorageError.
    """
    try:
        evaluated = trials_from_evaluation(map_, stored_evaluation.read_forms(cfg))
    except (KeyError, TypeError) as error:
        raise StorageError(
            "the evaluation of the map cannot be read",
            where=stored_evaluation.FILE,
            hint="evaluate the map again",
        ) from error
    if evaluated.by_photo:
        return evaluated
    survey = health.read_health(cfg)
    states = {} if survey is None else {photo["id"]: photo["state"] for photo in survey["photos"]}
    placed = {e.id for e in map_.experiences}
    by_photo = {id: PhotoTrial(float(state in _RECOGNISED)) for id, state in states.items() if id in placed}
    return MapTrials("health" if by_photo else "none", by_photo)


def trials_from_evaluation(map_: Map, schemes: Iterable[Mapping[str, Any]]) -> MapTrials:
    """Return the trials in the output of `expmap evaluate --self --json`, of photos not moved since."""
    every = list(schemes)
    chosen = [one for one in every if one["scheme"] == "leave-one-out"] or every
    by_path = {e.photo: e for e in map_.experiences}
    found: dict[int, list[PhotoTrial]] = {}
    for scheme in chosen:
        radius = scheme["place_radius_px"]
        for result in scheme["per_query"]:
            e, truth = by_path.get(result["path"]), result["truth"]
            if e is not None and math.dist(e.position, (truth["x_px"], truth["y_px"])) <= radius:
                found.setdefault(e.id, []).append(_trial(result, radius))
    by_photo = {id: _joined(trials) for id, trials in found.items()}
    return MapTrials("evaluation" if by_photo else "none", by_photo)


def _trial(result: Mapping[str, Any], radius: float) -> PhotoTrial:
    answer = result["answer"]
    if not isinstance(answer, Mapping):
        raise TypeError("an answer is an object")
    first = next(iter(answer.get("hypotheses", ())), None)
    if first is None or result["error_px"] is None or result["error_px"] > radius:
        return PhotoTrial(0.0)
    return PhotoTrial(1.0, first["heading_deg"])


def _joined(trials: Sequence[PhotoTrial]) -> PhotoTrial:
    headings = (trial.heading_deg for trial in trials if trial.heading_deg is not None)
    return PhotoTrial(sum(trial.success for trial in trials) / len(trials), next(headings, None))


def _photos(
    experiences: Sequence[Experience], trials: Mapping[int, PhotoTrial]
) -> tuple[PhotoTrials, list[int]]:
    """Return the input of the model, and the photo id of each row; a panorama has a row per direction."""
    rows: list[tuple[float, float, float, float]] = []
    ids: list[int] = []
    for e in experiences:
        trial = trials.get(e.id, PhotoTrial(math.nan))
        headings: list[float | None] = [e.heading_deg if e.heading_deg is not None else trial.heading_deg]
        if e.panorama is not None:
            headings = [turn * STEP_DEG for turn in range(DIRECTIONS)]
        for heading in headings:
            rows.append((*e.position, math.nan if heading is None else heading, trial.success))
            ids.append(e.id)
    table = np.array(rows, np.float64)
    return PhotoTrials(table[:, :2], table[:, 2], table[:, 3], np.array(ids, np.int64)), ids


def _on_image(area: Rectangle | None, image: Rectangle) -> Rectangle | None:
    if area is None:
        return None
    left, top = max(area.left, image.left), max(area.top, image.top)
    right, bottom = min(area.right, image.right), min(area.bottom, image.bottom)
    if not (left < right and top < bottom):  # also for NaN
        raise UsageError("the area is not on the image", where="area", hint="left < right, top < bottom")
    return Rectangle(left, top, right, bottom)


def plan_json(plan: PhotoPlan) -> dict[str, Any]:
    """Convert a plan to JSON values, documented in `docs/results.md`."""
    grid, scale = plan.grid, plan.scale
    shown = grid.wanted
    return {
        "revision": plan.map_.revision,
        "trials": plan.trials.source,
        "tried": len(plan.trials.by_photo),
        "recognised_share": round(grid.share, 4),
        "expected_share": round(plan.expected_share, 4),
        "walk_px": round(plan.walk_px, 1),
        "walk_m": None if scale is None else round(plan.walk_px * scale, 1),
        "cell_px": round(grid.side, 3),
        "cells": {
            "x_px": grid.cell[shown, 0].round(1).tolist(),
            "y_px": grid.cell[shown, 1].round(1).tolist(),
            "recognised": grid.mean[shown].mean(axis=1).round(3).tolist(),
            "sigma": grid.sigma[shown].mean(axis=1).round(3).tolist(),
        },
        "spots": [
            {
                "number": number,
                "x_px": round(spot.position[0], 1),
                "y_px": round(spot.position[1], 1),
                "lat": at and round(at.lat, 7),
                "lon": at and round(at.lon, 7),
                "headings_deg": list(spot.headings_deg),
                "reason": spot.reason,
                "photos": list(spot.photos),
                "gain": round(spot.gain, 5),
            }
            for number, (spot, at) in enumerate(zip(plan.spots, plan.latlon, strict=True), start=1)
        ],
    }


def keep(cfg: Path, plan: PhotoPlan) -> dict[str, Any]:
    """Store a plan for the pages of the map, replacing the previous one. Raises StorageError.

    Returns:
        As `plan_json`, with a new `id`.
    """
    content = {"version": _VERSION, "id": secrets.token_hex(8), **plan_json(plan)}
    make_folder(_path(cfg).parent)
    write_text(_path(cfg), json.dumps(content))
    return content


def read(cfg: Path) -> dict[str, Any] | None:
    """Read the stored plan; None if there is none of this version. Raises StorageError."""
    try:
        content: dict[str, Any] = json.loads(_path(cfg).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StorageError("the plan of photos cannot be read", where=_FILE, hint="plan again") from error
    return content if content.get("version") == _VERSION else None


def _path(cfg: Path) -> Path:
    return cfg.parent / DERIVED / _FILE


@dataclass(frozen=True, slots=True)
class PlanWords:
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
    """Return in words where to look at a spot of `plan_json`."""
    names = [direction_of(h, words) for h in spot["headings_deg"]]
    return words.look.format(directions=", ".join(names)) if names else words.look_around


def walk_of(plan: Mapping[str, Any], words: PlanWords = ENGLISH) -> list[WalkPoint]:
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


_ACCURACY_M = 10.0
"""Accuracy with which people reach a spot by the GPS of a phone."""

_OF_IMAGE = 0.02
"""The same as a share of the image's longer side, if it has no georeference."""


@dataclass(frozen=True, slots=True)
class TargetPose:
    """Planned position and heading of a photo."""

    position: MapPixel
    heading_deg: float | None = None
    revision: int | None = None  # Revision of the map when the spot was planned; None for the current one


def add_photo_at_spot(
    library: Library, map_id: int, *, photo: IncomingPhoto, pose: TargetPose, settings: Settings
) -> tuple[AddedPhoto, bool]:
    """Add a photo to a map, as `add_photo`; without GPS, suggest the spot as its place.

    Raises PhotoError, NotFound, UsageError, DiskFull, StorageError.

    Returns:
        intake:
        suggested: It is in the tray, and the spot is suggested as its place; never if the image was replaced,
            or the spot is outside it.
    """
    intake = add_photo(library, map_id, photo=photo, settings=settings)
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        row = maps.photo(session, record, intake.id)
        if row.x_px is not None or row.gps_lat is not None or record.satellite_path is None:
            return intake, False
        radius = _radius_px(record, pose)
        if radius is None:
            return intake, False
        place = SuggestedPlace(row.id, row.path, pose.position, radius, pose.heading_deg, ())
        cfg, revision = library.cfg(record.slug), record.revision
    stored.suggest(cfg, place, revision=revision)
    return intake, True


def _radius_px(record: MapRecord, pose: TargetPose) -> float | None:
    """Return the radius around a spot that contains its photo; None if it is not on the current image."""
    image = needed_image(record, with_georeference=False)
    replaced = pose.revision is not None and pose.revision < record.satellite_revision
    if replaced or not inside(pose.position, width=image.width, height=image.height):
        return None
    where = georeference(record)
    if where is None:
        return _OF_IMAGE * max(image.width, image.height)
    scale = where.metres_per_pixel(pose.position)
    return _ACCURACY_M / scale if math.isfinite(scale) and scale > 0.0 else None
