"""Jobs in the form in which pages and clients get them."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import CompoundSelect, Select, func, or_, select, union_all
from sqlalchemy.orm import Session, aliased

from webapp.store.database import moment
from webapp.store.operate.jobs import ENDED, LIVE
from webapp.store.outbox import DELIVERY_JOB
from webapp.store.schema import Account, Edit, Job, MapRecord

TILES_JOB = "satellite-tiles"
"""The kind of the jobs that fetch an image."""

PYRAMID_JOB = "satellite-pyramid"
"""The kind of the jobs that prepare a large image for display."""

_SHOWN = timedelta(minutes=1)
"""For how long the page of a map shows a job that has ended."""

_STARTS_WITHIN = timedelta(seconds=3)
"""Time within which a free worker takes a job."""

_FAILURE_SHOWN = timedelta(days=7)
"""For how long the page of a map shows a job that has failed, unless a newer one of its kind follows."""

_RECENT = timedelta(days=1)
_MOST_RECENT = 20
"""The same for the menu of all pages."""


def current(session: Session, map_id: int) -> list[Job]:
    """List the jobs of a map that wait, run, or have ended in the last minute, oldest first."""
    shown = Job.id.in_(_not_ended_before(moment(session) - _SHOWN))
    return list(session.scalars(select(Job).where(Job.map_id == map_id, shown).order_by(Job.id)))


def shown(session: Session, map_id: int) -> list[Job]:
    """List the current jobs of a map, and those that failed last of their kind and key, oldest first.

    A failure is over once the same was queued again, another job of its kind succeeded or, if it concerns
    the image, the map got another one.
    """
    newer, at = aliased(Job), moment(session)
    same = (newer.map_id == Job.map_id, newer.kind == Job.kind)
    again = select(newer.id).where(*same, newer.key == Job.key, newer.id > Job.id)
    succeeded = select(newer.id).where(*same, newer.state == "done", newer.ended_at > Job.ended_at)
    image = select(Edit.id).where(
        Edit.map_id == Job.map_id,
        Edit.kind == "satellite",
        Edit.at > Job.created_at,
        Job.kind.in_((TILES_JOB, PYRAMID_JOB)),
    )
    is_over = or_(again.exists(), succeeded.exists(), image.exists())
    shown = or_(
        Job.id.in_(_not_ended_before(at - _SHOWN)),
        (Job.state == "failed") & (Job.ended_at > at - _FAILURE_SHOWN),
    )
    found = select(Job).where(Job.map_id == map_id, shown, ~((Job.state == "failed") & is_over))
    return list(session.scalars(found.order_by(Job.id)))


def recent(session: Session, *, map_ids: Select[Any], account: Account) -> list[Job]:
    """List the jobs of some maps that wait, run, or have ended in the last day, active ones first.

    Jobs without a map are included if they are the account's own; an owner of the library gets all jobs.
    """
    alone = Job.map_id.is_(None)
    theirs = alone if account.is_owner else alone & (Job.account_id == account.id)
    shown = (
        or_(Job.map_id.in_(map_ids), theirs),
        Job.id.in_(_not_ended_before(moment(session) - _RECENT)),
        Job.kind != DELIVERY_JOB,  # their accounts see each message on a page of their own
    )
    found = select(Job).where(*shown).order_by(Job.state.in_(ENDED), Job.id.desc()).limit(_MOST_RECENT)
    return list(session.scalars(found))


def _not_ended_before(at: datetime) -> CompoundSelect[tuple[int]]:
    """Select the ids of jobs that wait, run, or have ended since; each part uses an index."""
    live, ended = select(Job.id).where(Job.state.in_(LIVE)), select(Job.id).where(Job.ended_at > at)
    return union_all(live, ended)


@dataclass(frozen=True, slots=True)
class QueueFigures:
    # `waiting`, `running`: Numbers of jobs.
    waiting: int
    running: int
    abandoned: int  # Number of running jobs without a lease, or whose lease has expired
    oldest_s: float  # Seconds for which the oldest waiting job has waited


def queue_figures(session: Session) -> QueueFigures:
    at = moment(session)
    is_left = or_(Job.leased_until.is_(None), Job.leased_until < at)
    running = select(func.count()).where(Job.state == "running")
    waiting = select(func.count(), func.min(Job.created_at)).where(Job.state == "queued")
    count, oldest = session.execute(waiting).one()
    return QueueFigures(
        count,
        session.scalar(running) or 0,
        session.scalar(running.where(is_left)) or 0,
        0.0 if oldest is None else max((at - oldest).total_seconds(), 0.0),
    )


def seconds_left(job: Job, *, at: datetime) -> float | None:
    """Estimate the remaining time of a job from its pace so far; None if unknown."""
    if job.state != "running" or job.started_at is None or not 0 < job.done <= job.total:
        return None
    return (at - job.started_at).total_seconds() * (job.total - job.done) / job.done


def blocker(session: Session, job: Job, *, short: Collection[str]) -> Job | None:
    """Find the running job that one waits for: of its map, else the one of its lane that ends first.

    Args:
        short: The short kinds; the others are the second lane.
    """
    at = moment(session)
    if job.state != "queued" or (job.not_before is not None and job.not_before > at):
        return None
    running = session.scalars(select(Job).where(Job.state == "running").order_by(Job.id)).all()
    same = [one for one in running if (one.kind in short) == (job.kind in short)]
    if not same and at - job.created_at > _STARTS_WITHIN:  # its lane has no worker of its own
        same = list(running)
    own = [one for one in same if one.map_id == job.map_id is not None]

    def left(one: Job) -> float:
        seconds = seconds_left(one, at=at)
        return math.inf if seconds is None else seconds

    return min(own or same, key=left, default=None)


def to_json(session: Session, job: Job, *, account_id: int | None = None) -> dict[str, Any]:
    """Return the JSON object for pages and clients.

    Returns:
        `id, kind, state, done, total, note, error, result, seconds, seconds_left, next_try_s, created_at,
            mine, map`; `seconds` is the running time so far, `next_try_s` the time until the next try, `mine`
            whether the account has started it, `map` the slug.
    """
    record = None if job.map_id is None else session.get(MapRecord, job.map_id)
    left = seconds = None
    if job.started_at is not None:
        at = job.ended_at or moment(session)
        left, seconds = seconds_left(job, at=at), (at - job.started_at).total_seconds()
    waits_until = job.not_before if job.state == "queued" else None
    pause = None if waits_until is None else max((waits_until - moment(session)).total_seconds(), 0.0)
    return {
        "id": job.id,
        "kind": job.kind,
        "state": job.state,
        "done": job.done,
        "total": job.total,
        "note": job.note,
        "error": job.error,
        "result": job.result,
        "seconds": None if seconds is None else round(seconds, 1),
        "seconds_left": None if left is None else round(left, 1),
        "next_try_s": None if pause is None else round(pause, 1),
        "created_at": job.created_at.isoformat(timespec="seconds"),
        "mine": account_id is not None and job.account_id == account_id,
        "map": None if record is None else record.slug,
    }
