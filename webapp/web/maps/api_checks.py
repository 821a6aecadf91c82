"""API of the checks of a map, the survey of its weak places, and its evaluation on its own photos."""

from __future__ import annotations

import secrets
from dataclasses import asdict
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Float, Integer, List, Nested, String
from apiflask.validators import Length, Range
from flask import Response
from flask_babel import LazyString, lazy_gettext
from flask_babel import gettext as _
from sqlalchemy import select
from werkzeug.datastructures import FileStorage

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.recognition import Rectangle
from webapp.errors import Conflict, NotFound, UsageError
from webapp.files.exchange.gpx import format_walk_gpx
from webapp.files.part_file import discard, receive
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks import photo_plan
from webapp.tasks.exchange.export_source import Download, plain_name
from webapp.tasks.maps import findings, health, outside_edit
from webapp.tasks.maps.add_photo import IncomingPhoto, tidy_name
from webapp.tasks.maps.findings import FixName
from webapp.tasks.maps.library_map import as_map
from webapp.tasks.photo_plan import (
    MOST_SPOTS,
    PlanRequest,
    PlanWords,
    TargetPose,
    walk_of,
)
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import Boolean, BoundedList, RecordNumber
from webapp.web.maps import state as map_state
from webapp.web.maps.api_photos import IntakeOut, intake_json
from webapp.web.maps.schemas import EditAnswer, JobSchema
from webapp.web.openapi import file_answer
from webapp.web.operate.jobs import job_json
from webapp.web.sending import send_pieces

checks_api = APIBlueprint("api_checks", __name__, url_prefix="/api/v1/maps/<slug>", tag="Checks")
evaluation_api = APIBlueprint("api_evaluation", __name__, url_prefix="/api/v1/maps/<slug>", tag="Checks")

_MOST = 10_000
_HEALTH_JOB = "health"

LABELS: dict[FixName, LazyString] = {
    "to-tray": lazy_gettext("Move to the tray"),
    "remove": lazy_gettext("Remove from the map"),
    "swap": lazy_gettext("Swap x and y"),
    "adopt": lazy_gettext("Add to the tray"),
    "image-size": lazy_gettext("Use the actual size"),
    "outside-take": lazy_gettext("Apply the changes"),
    "outside-discard": lazy_gettext("Overwrite the file"),
}
"""Label on the button of each fix."""

_EVALUATE_JOB = "evaluate"


class FixOut(Schema):
    """A fix, shown as a button."""

    code = String(metadata={"enum": list(LABELS)})
    label = String()


class FindingOut(Schema):
    """A problem of a map."""

    code = String()
    severity = String(metadata={"enum": ["error", "warning"]})
    message = String()
    hint = String(allow_none=True)
    ids = List(Integer(), metadata={"description": "Photos that it is about."})
    fixes = List(Nested(FixOut))


class FindingsOut(Schema):
    """All problems of a map, errors first."""

    revision = Integer()
    findings = List(Nested(FindingOut))


class FixIn(Schema):
    """A fix, and the photos to apply it to."""

    code = String(required=True, validate=Length(max=40))
    ids = BoundedList(RecordNumber(), load_default=list, most=_MOST)


class PhotoHealthOut(Schema):
    """Result of the survey for one photo."""

    id = Integer()
    state = String(metadata={"enum": ["confusable", "lonely", "one-direction", "good"]})
    taken_for = Integer(allow_none=True, metadata={"description": "The photo that it was taken for."})
    probability = Float(allow_none=True)


class HealthOut(Schema):
    """The weak places of a map."""

    revision = Integer(allow_none=True, metadata={"description": "Of the map then; null: not known yet."})
    current = Boolean(metadata={"description": "Whether nothing was changed since."})
    place_radius_px = Float(allow_none=True)
    photos = List(Nested(PhotoHealthOut))
    job = Integer(allow_none=True, metadata={"description": "Id of the job that is computing this now."})


class OutsideOut(Schema):
    """Differences between the map and its `map.cfg` on the disk, if that was edited externally."""

    changed = Boolean()
    sha256 = String(metadata={"description": "Of the file; `take` and `discard` want it back."})
    problem = String(allow_none=True, metadata={"description": "Why it cannot be taken over."})
    moved = List(Dict())
    turned = List(Dict())
    added = List(Dict())
    removed = List(Dict())
    kept = List(Dict(), metadata={"description": "Changed here too: they stay as they are here."})
    left_out = List(String())
    placements = List(String())
    control_points = List(String(), metadata={"description": "Names of those that change."})
    notes = List(String(), metadata={"description": "Titles of those that change; of photos, their names."})
    floors = List(String(), metadata={"description": "Names of those that change."})
    georeference = Boolean()


class OutsideSeen(Schema):
    """Hash of the file that the caller has seen."""

    sha256 = String(required=True, validate=Length(equal=64))


class OutsideAnswer(EditAnswer):
    """Result of applying the file."""

    left_out = List(String())


@checks_api.get("/findings")
@checks_api.output(FindingsOut)
def show_findings(slug: str) -> dict[str, Any]:
    """Check the map."""
    record = open_map(slug)
    found = findings.list_findings(library(), record.id, settings=settings())
    items = [
        {**asdict(problem), "fixes": [{"code": fix, "label": str(LABELS[fix])} for fix in problem.fixes]}
        for problem in found
    ]
    return {"revision": record.revision, "findings": items}


@checks_api.post("/findings/fix")
@map_role("editor")
@checks_api.input(FixIn, arg_name="data")
@checks_api.output(EditAnswer)
def fix(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Fix a problem, as one step that can be undone."""
    record, who = open_map(slug, "editor"), account()
    revision = findings.fix_findings(
        library(), record.id, fix=data["code"], ids=data["ids"], account_id=who.id, settings=settings()
    )
    return map_state.edited(record, revision)


@checks_api.get("/health")
@checks_api.output(HealthOut)
def show_health(slug: str) -> dict[str, Any]:
    """Get the last survey of the weak places of the map."""
    return _health(open_map(slug))


@checks_api.post("/health")
@checks_api.output(HealthOut, status_code=202)
def find_health(slug: str) -> dict[str, Any]:
    """Queue a survey of the weak places of the map."""
    record, who = open_map(slug), account()
    with library().database.write() as session:
        jobs.enqueue(session, _HEALTH_JOB, map_id=record.id, account_id=who.id)
    return _health(record)


@checks_api.get("/outside-edit")
@checks_api.output(OutsideOut)
def show_outside(slug: str) -> dict[str, Any]:
    """Get whether and how `map.cfg` was edited outside this program."""
    return _outside(open_map(slug))


@checks_api.post("/outside-edit/take")
@map_role("editor")
@checks_api.input(OutsideSeen, arg_name="data")
@checks_api.output(OutsideAnswer)
def take_outside(slug: str, data: dict[str, str]) -> dict[str, Any]:
    """Apply the changed file, as one step that can be undone."""
    record, who = open_map(slug, "editor"), account()
    taken = outside_edit.take(
        library(), record.id, account_id=who.id, settings=settings(), sha256=data["sha256"]
    )
    return {**map_state.edited(record, taken.revision), "left_out": taken.left_out}


@checks_api.post("/outside-edit/discard")
@map_role("editor")
@checks_api.input(OutsideSeen, arg_name="data")
@checks_api.output(OutsideOut)
def discard_outside(slug: str, data: dict[str, str]) -> dict[str, Any]:
    """Overwrite the file with the state of the map."""
    record = open_map(slug, "editor")
    if outside_edit.show(library(), record.id, settings=settings()) is None:
        raise Conflict("the file has not changed", hint="reload and compare again")
    outside_edit.discard(library(), record.id, sha256=data["sha256"])
    return _outside(record)


def _health(record: MapRecord) -> dict[str, Any]:
    found = health.read_health(library().cfg(record.slug))
    with library().database.read() as session:
        running = select(Job.id).where(
            Job.map_id == record.id, Job.kind == _HEALTH_JOB, Job.state.not_in(ENDED)
        )
        job = session.scalars(running.limit(1)).first()
        current = found is not None and not maps.alters_answers(session, record, since=found["revision"])
    if found is None:
        return {"revision": None, "current": False, "place_radius_px": None, "photos": [], "job": job}
    return {**found, "current": current, "job": job}


def _outside(record: MapRecord) -> dict[str, Any]:
    shown = outside_edit.show(library(), record.id, settings=settings())
    return {"changed": False} if shown is None else {"changed": True, **shown}


class EvaluationRequest(Schema):
    """Extent of the evaluation."""

    limit = Integer(
        load_default=None,
        allow_none=True,
        validate=Range(1, _MOST),
        metadata={"description": "Number of photos, evenly spread over the map; null for all."},
    )


@evaluation_api.post("/evaluation")
@map_role("editor")
@evaluation_api.input(EvaluationRequest, arg_name="data")
@evaluation_api.output(JobSchema, status_code=202)
def evaluate(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Queue the evaluation of the map on its own photos; the job's result has the figures."""
    record, who = open_map(slug, "editor"), account()
    with library().database.write() as session:
        job = jobs.enqueue(session, _EVALUATE_JOB, map_id=record.id, account_id=who.id, arguments=data)
        session.flush()
        return job_json(session, job, account=who)


plan_api = APIBlueprint("api_plan", __name__, url_prefix="/api/v1/maps/<slug>/photo-plan", tag="Checks")

_limit = ConcurrencyLimit("plans of photos", share=0.25)
plan_api.record(_limit.set_up)

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


@plan_api.get("")
@plan_api.output(PlanOut)
def show(slug: str) -> dict[str, Any]:
    """Get the latest plan of the next photos."""
    return _plan(open_map(slug))


@plan_api.post("")
@map_role("editor")
@plan_api.input(PlanIn, arg_name="data")
@plan_api.output(PlanOut)
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


@plan_api.get("/walk.gpx")
@map_role("viewer")
@plan_api.doc(responses=file_answer("Waypoints and a route, GPX 1.1.", "application/gpx+xml"))
def walk(slug: str) -> Response:
    """Download the walk of the latest plan."""
    record = open_map(slug)
    plan = photo_plan.read(library().cfg(record.slug))
    if plan is None:
        raise NotFound("no photos are planned yet", hint="plan them first")
    title = _("%(name)s: photos to take", name=record.name)
    pieces = format_walk_gpx(walk_of(plan, _words()), title=title)
    return send_pieces(Download(f"{plain_name(record.slug)}-photos.gpx", "application/gpx+xml", pieces))


@plan_api.post("/photos")
@map_role("editor")
@plan_api.input(SpotPhotoIn, location="form_and_files", arg_name="given")
@plan_api.output(SpotPhotoOut)
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
