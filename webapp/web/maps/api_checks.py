"""API of the checks of a map, the survey of its weak places, and its evaluation on its own photos."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Dict, Float, Integer, List, Nested, String
from apiflask.validators import Length, Range
from flask_babel import LazyString, lazy_gettext
from sqlalchemy import select

from webapp.errors import Conflict
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.maps import findings, health, outside_edit
from webapp.tasks.maps.findings import FixName
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import BoundedList, RecordNumber
from webapp.web.maps import state as map_state
from webapp.web.maps.schemas import EditAnswer, JobSchema
from webapp.web.operate.jobs import job_json

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
