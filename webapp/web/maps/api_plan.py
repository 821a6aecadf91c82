"""API of the plan of the next photos of a map: the plan, its walk, and adding photos taken at its spots."""

from __future__ import annotations

import secrets
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from apiflask.validators import Range
from flask import Response
from flask_babel import gettext as _
from werkzeug.datastructures import FileStorage

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.recognition import Rectangle
from webapp.errors import NotFound, UsageError
from webapp.files.exchange.gpx import format_walk_gpx
from webapp.files.part_file import discard, receive
from webapp.store.schema import MapRecord
from webapp.tasks import photo_plan
from webapp.tasks.exchange.export_source import Download, plain_name
from webapp.tasks.maps.add_photo import IncomingPhoto, tidy_name
from webapp.tasks.maps.library_map import as_map
from webapp.tasks.photo_plan import (
    MOST_SPOTS,
    PlanRequest,
    PlanWords,
    TargetPose,
    walk_of,
)
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import library, map_role, open_map, settings
from webapp.web.fields import Boolean, BoundedList, RecordNumber
from webapp.web.maps.api_photos import IntakeOut, intake_json
from webapp.web.openapi import file_answer
from webapp.web.sending import send_pieces

blueprint = APIBlueprint("api_plan", __name__, url_prefix="/api/v1/maps/<slug>/photo-plan", tag="Checks")

_limit = ConcurrencyLimit("plans of photos", share=0.25)
blueprint.record(_limit.set_up)

_FAR_PX = 1e6


class PlanIn(Schema):
    """Request of a plan."""

    spots = Integer(load_default=12, validate=Range(1, MOST_SPOTS))
    area = BoundedList(
        Float(validate=Range(-_FAR_PX, _FAR_PX)),
        load_default=None,
        allow_none=True,
        least=4,
        most=4,
        metadata={"description": "Left, top, right, bottom, map pixels; null for what is near photos."},
    )


class CellsOut(Schema):
    """Square cells of the map, with one value per cell."""

    x_px = List(Float(), metadata={"description": "Of the middles."})
    y_px = List(Float())
    recognised = List(Float(), metadata={"description": "Share of photos in all directions."})
    sigma = List(Float(), metadata={"description": "Standard deviation of the share."})


class SpotOut(Schema):
    """A spot at which to take photos."""

    number = Integer(metadata={"description": "In the order of the walk."})
    x_px = Float()
    y_px = Float()
    lat = Float(allow_none=True)
    lon = Float(allow_none=True)
    headings_deg = List(
        Float(), metadata={"description": "Clockwise from north, the most useful first; empty: all around."}
    )
    reason = String(metadata={"enum": ["not-recognised", "one-direction", "direction", "few-photos"]})
    photos = List(Integer(), metadata={"description": "Photos that the reason is about."})
    gain = Float(metadata={"description": "By how much the recognised share grows, as expected."})


class PhotoPlanOut(Schema):
    """A plan, as `expmap map plan --json` prints it."""

    id = String(metadata={"description": "Another one for each plan."})
    revision = Integer(metadata={"description": "Of the map then."})
    trials = String(metadata={"enum": ["evaluation", "health", "none"]})
    tried = Integer(metadata={"description": "Photos that were tried."})
    recognised_share = Float()
    expected_share = Float()
    walk_px = Float()
    walk_m = Float(allow_none=True)
    cell_px = Float(metadata={"description": "Side of a cell."})
    cells = Nested(CellsOut)
    spots = List(Nested(SpotOut))


class PlanOut(Schema):
    """The latest plan."""

    plan = Nested(PhotoPlanOut, allow_none=True, metadata={"description": "Null: none was made yet."})
    current = Boolean(metadata={"description": "Whether nothing was changed since."})
    replaced = Boolean(metadata={"description": "Whether its spots are on an image that was replaced since."})


class SpotPhotoIn(Schema):
    """A photo taken at a spot."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    x_px = Float(required=True, validate=Range(-_FAR_PX, _FAR_PX))
    y_px = Float(required=True, validate=Range(-_FAR_PX, _FAR_PX))
    heading_deg = Float(load_default=None, validate=Range(-360, 360))
    revision = RecordNumber(
        load_default=None,
        metadata={"description": "That of the plan: a spot on an image that was replaced is not suggested."},
    )


class SpotPhotoOut(IntakeOut):
    """The result for the photo."""

    suggested = Boolean(metadata={"description": "It has no GPS, and waits with the spot as a suggestion."})


@blueprint.get("")
@blueprint.output(PlanOut)
def show(slug: str) -> dict[str, Any]:
    """Get the latest plan of the next photos."""
    return _plan(open_map(slug))


@blueprint.post("")
@map_role("editor")
@blueprint.input(PlanIn, arg_name="data")
@blueprint.output(PlanOut)
def make(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Plan the next photos, and replace the previous plan."""
    record = open_map(slug, "editor")
    area = None if data["area"] is None else Rectangle(*data["area"])
    with library().database.read() as session:
        map_ = as_map(session, session.get_one(MapRecord, record.id))
    if map_ is None:
        raise UsageError("the map has no satellite image yet", hint="give it one first")
    cfg = library().cfg(record.slug)
    with _limit.slot():
        trials = photo_plan.trials_of(map_, cfg)
        made = photo_plan.plan_photos(map_, trials=trials, request=PlanRequest(data["spots"], area))
    photo_plan.keep(cfg, made)
    return _plan(record)


@blueprint.get("/walk.gpx")
@map_role("viewer")
@blueprint.doc(responses=file_answer("Waypoints and a route, GPX 1.1.", "application/gpx+xml"))
def walk(slug: str) -> Response:
    """Download the walk of the latest plan."""
    record = open_map(slug)
    plan = photo_plan.read(library().cfg(record.slug))
    if plan is None:
        raise NotFound("no photos are planned yet", hint="plan them first")
    title = _("%(name)s: photos to take", name=record.name)
    pieces = format_walk_gpx(walk_of(plan, _words()), title=title)
    return send_pieces(Download(f"{plain_name(record.slug)}-photos.gpx", "application/gpx+xml", pieces))


@blueprint.post("/photos")
@map_role("editor")
@blueprint.input(SpotPhotoIn, location="form_and_files", arg_name="given")
@blueprint.output(SpotPhotoOut)
def add(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Add a photo taken at a spot; without GPS, it goes to the tray with the spot as suggested position."""
    record = open_map(slug, "editor")
    file: FileStorage = given["file"]
    part = library().uploads / f"{secrets.token_hex(16)}.part"
    pose = TargetPose(MapPixel(given["x_px"], given["y_px"]), given["heading_deg"], given["revision"])
    try:
        receive(part, file.stream, max_bytes=int(settings().photo.max_mb * 1e6))
        photo = IncomingPhoto(part, tidy_name(file.filename or ""))
        intake, suggested = photo_plan.add_photo_at_spot(
            library(), record.id, photo=photo, pose=pose, settings=settings()
        )
    finally:
        discard(part)
    return {**intake_json(intake), "suggested": suggested}


def _plan(record: MapRecord) -> dict[str, Any]:
    found = photo_plan.read(library().cfg(record.slug))
    revision = record.revision if found is None else found["revision"]
    return {
        "plan": found,
        "current": found is not None and revision == record.revision,
        "replaced": revision < record.satellite_revision,
    }


def _words() -> PlanWords:
    return PlanWords(
        (
            _("north"),
            _("north-east"),
            _("east"),
            _("south-east"),
            _("south"),
            _("south-west"),
            _("west"),
            _("north-west"),
        ),
        {
            "not-recognised": _("photos here were not recognised"),
            "one-direction": _("seen in one direction only"),
            "direction": _("no photo looks this way"),
            "few-photos": _("few photos near here"),
        },
        _("look {directions}"),
        _("look all around"),
    )
