"""Operation of a server: the API and page of jobs, their JSON, and health checks."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import List, Nested, String
from flask import Blueprint, render_template
from flask_babel import lazy_gettext as _l
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.jobs.health import Health, Report
from webapp.store.database import moment
from webapp.store.maps import maps
from webapp.store.maps.maps import Role
from webapp.store.operate import job_views, jobs
from webapp.store.schema import Account, Job, MapRecord
from webapp.web.context import account, library, open_map, public, settings
from webapp.web.fields import LATER, Boolean
from webapp.web.language import translate_job
from webapp.web.maps.schemas import JobSchema
from webapp.web.pages import Tab, page
from webapp.web.state import parts

jobs_api = APIBlueprint("jobs", __name__, url_prefix="/api/v1/jobs", tag="Jobs")
jobs_pages = Blueprint("jobs_pages", __name__)
health_pages = Blueprint("health", __name__)


class JobQuery(Schema):
    """Filter of jobs."""

    map = String(
        load_default=None,
        validate=LATER,
        metadata={"description": "Slug of a map; without it, the recent jobs of all that you may see."},
    )


class ListedJob(JobSchema):
    """A job, with its map's name and its starter."""

    map_name = String(allow_none=True)
    by = String(
        allow_none=True, metadata={"description": "Who has started it; null: a change of the map did."}
    )
    can_change = Boolean(metadata={"description": "Whether you may cancel it or try it again."})


class JobList(Schema):
    """Jobs: those of one map with the newest first, those of all maps with the active ones first."""

    jobs = List(Nested(ListedJob))


@jobs_api.get("")
@jobs_api.input(JobQuery, location="query", arg_name="query")
@jobs_api.output(JobList)
def listed(query: dict[str, str | None]) -> dict[str, Any]:
    """List the latest jobs of a map, or the jobs of all maps that wait, run, or ended within the last day."""
    slug, who = query["map"], account()
    record = None if slug is None else open_map(slug)
    with library().database.read() as session:
        if record is not None:
            found = jobs.list_jobs(session, map_id=record.id)
        else:
            found = job_views.recent(session, map_ids=maps.visible(who), account=who)
        return {"jobs": [_job_json(session, job) for job in found]}


@jobs_api.get("/<id:job_id>")
@jobs_api.output(ListedJob)
def one(job_id: int) -> dict[str, Any]:
    """Get the progress of a job."""
    with library().database.read() as session:
        return _job_json(session, _job(session, job_id, role="viewer"))


@jobs_api.post("/<id:job_id>/cancel")
@jobs_api.output(ListedJob)
def cancel(job_id: int) -> dict[str, Any]:
    """Cancel a job of the caller, or of a map that the caller may edit; its finished steps are kept."""
    with library().database.write() as session:
        job = _job(session, job_id, role="editor")
        jobs.cancel(session, job)
        return _job_json(session, job)


@jobs_api.post("/<id:job_id>/retry")
@jobs_api.output(ListedJob)
def retry(job_id: int) -> dict[str, Any]:
    """Queue a failed or cancelled job again."""
    with library().database.write() as session:
        job = jobs.retry(session, _job(session, job_id, role="editor"))
        return _job_json(session, job)


def _job(session: Session, job_id: int, *, role: Role) -> Job:
    """Find a job of a map on which the caller has a role, or the caller's own job on a visible map."""
    job = jobs.find(session, job_id)
    who = account()
    record = None if job.map_id is None else session.get(MapRecord, job.map_id)
    if record is not None and maps.role_of(session, record, account=who) is not None:
        maps.find(session, record.slug, account=who, role="viewer" if job.account_id == who.id else role)
    elif record is not None or (job.account_id != who.id and not who.is_owner):
        raise NotFound(f"job {job_id} not found", hint="reload the page")
    return job


def _job_json(session: Session, job: Job) -> dict[str, Any]:
    who = account()
    record = None if job.map_id is None else session.get(MapRecord, job.map_id)
    starter = None if job.account_id is None else session.get(Account, job.account_id)
    role = "owner" if who.is_owner else None
    if record is not None:
        role = maps.role_of(session, record, account=who)
    return {
        **job_json(session, job, account=who),
        "map_name": None if record is None else record.name,
        "by": None if starter is None else starter.name,
        "can_change": job.account_id == who.id or role in ("editor", "owner"),
    }


@jobs_pages.get("/maps/<slug>/jobs")
@page(chapter="make-a-map#4-check", tab=Tab(_l("Jobs"), "clock", order=6))
def show_jobs(slug: str) -> str:
    """Show the jobs of a map; the page fetches and updates the list by the API."""
    record = open_map(slug)
    return render_template("operate/jobs.html", map=record)


@health_pages.get("/livez")
@public
def livez() -> Report:
    """Answer as the supervisor does; see `webapp.jobs.health`."""
    return Health(library(), settings()).live()


@health_pages.get("/readyz")
@public
def readyz() -> Report:
    """Answer as the supervisor does; see `webapp.jobs.health`."""
    return Health(library(), settings()).ready()


@health_pages.get("/healthz")
@public
def healthz() -> Report:
    """Answer as the supervisor does; see `webapp.jobs.health`."""
    return Health(library(), settings()).whole()


def job_json(session: Session, job: Job, *, account: Account) -> dict[str, Any]:
    form = job_views.to_json(session, job, account_id=account.id)
    return translate_job(form) | {"behind": _behind(session, job, account=account)}


def _behind(session: Session, job: Job, *, account: Account) -> dict[str, Any] | None:
    """Return what a waiting job waits for; the map is named only to those who may see it."""
    other = job_views.blocker(session, job, short=parts().short_jobs)
    if other is None:
        return None
    record = None if other.map_id is None else session.get(MapRecord, other.map_id)
    if record is not None and maps.role_of(session, record, account=account) is None:
        record = None
    left = job_views.seconds_left(other, at=moment(session))
    return {
        "kind": other.kind,
        "map_name": None if record is None else record.name,
        "seconds_left": None if left is None else round(left, 1),
    }
