"""Jobs: long work outside a request, in a queue.

Who works on a job holds a lease and renews it. A job whose lease has run out is taken over by the next who
asks, under a higher fencing number; who lost the lease can write nothing about the job any more (Kleppmann,
"How to do distributed locking", 2016). The jobs of one map take turns.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Select, case, func, or_, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, aliased

from webapp.errors import Conflict, NotFound
from webapp.store.database import moment
from webapp.store.schema import Job, MapRecord

ENDED = ("done", "failed", "cancelled")
LIVE = ("queued", "running")

_LONGEST_PAUSE_S = 300.0


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to write about a job, as long as nobody else has got it.

    Attributes
    ----------
    fence : int
        The job's fencing number at the time.
    """

    job_id: int
    fence: int


@dataclass(frozen=True, slots=True)
class Limits:
    """How long a lease lasts, and how many workers may die on a job.

    Attributes
    ----------
    seconds : float
        How long it lasts without being renewed.
    attempts : int
        Number of workers that may die on a job in a row, without a step done, before it fails; and
        after ten times as many in all, as it will never come to its end.
    """

    seconds: float
    attempts: int


def enqueue(
    session: Session,
    kind: str,
    *,
    map_id: int | None = None,
    account_id: int | None = None,
    arguments: Mapping[str, Any] | None = None,
    key: str = "",
) -> Job:
    """Put a job into the queue, or find the same one that waits there already.

    Parameters
    ----------
    session : Session
        That writes: the job is there when, and only when, all else of the session is.
    kind : str
        What is to be done.
    map_id, account_id : int or None
        Whose map it is about, and who wants it.
    arguments : mapping, optional
        Plain values for the work.
    key : str
        Two waiting jobs of one map, kind and key are one.
    """
    if (there := _waiting(session, kind, map_id=map_id, key=key)) is not None:
        return there  # locked, so that nobody begins with it before what this session changes is there
    job = Job(kind=kind, map_id=map_id, account_id=account_id, key=key, arguments=dict(arguments or {}))
    try:
        with session.begin_nested():
            session.add(job)
    except IntegrityError:
        # Another session was quicker, where the database lets two write at once.
        there = _waiting(session, kind, map_id=map_id, key=key)
        if there is None:
            raise
        return there
    return job


def key_of(arguments: Mapping[str, Any]) -> str:
    """Return a key that only jobs with equal arguments share."""
    return hashlib.sha256(json.dumps(arguments, sort_keys=True).encode()).hexdigest()


def find(session: Session, id: int) -> Job:
    """Find a job.

    Raises
    ------
    NotFound
    """
    job = session.get(Job, id)
    if job is None:
        raise NotFound(f"job {id} not found", hint="reload the page")
    return job


def list_jobs(session: Session, *, map_id: int | None = None, limit: int = 50) -> list[Job]:
    """List the jobs of a map, or of the library, the newest first."""
    found = select(Job) if map_id is None else select(Job).where(Job.map_id == map_id)
    return list(session.scalars(found.order_by(Job.id.desc()).limit(limit)))


def newest(session: Session, map_id: int | None, *, kind: str, key: str) -> Job | None:
    """Find the last job of a kind that was queued under a key for a map, or for none."""
    wanted = select(Job).where(Job.map_id == map_id, Job.kind == kind, Job.key == key)
    return session.scalar(wanted.order_by(Job.id.desc()).limit(1))


def cancel(session: Session, job: Job) -> None:
    """Cancel a job that waits; ask who works on it to stop; leave one that has ended as it is."""
    if job.state == "queued":
        _end(session, job, "cancelled")
    elif job.state == "running":
        job.cancel_wanted = True


def retry(session: Session, job: Job) -> Job:
    """Put a job that failed or was cancelled into the queue again.

    Returns
    -------
    Job
        The same, or one like it that waits already.

    Raises
    ------
    Conflict
        It has not ended, or is done.
    """
    if job.state not in ("failed", "cancelled"):
        raise Conflict(f"this job is {job.state} and cannot be retried", hint="reload the page")
    there = _waiting(session, job.kind, map_id=job.map_id, key=job.key)
    if there is not None:
        return there
    job.state, job.attempts, job.cancel_wanted = "queued", 0, False
    job.error = job.result = job.started_at = job.ended_at = None
    job.done, job.total, job.note = 0, 0, ""
    job.not_before, job.waits = None, 0
    session.flush()
    return job


def anything_to_do(session: Session, *, early: bool = False) -> bool:
    """Return whether a job runs, or waits and may begin: only then it is worth asking for a lease."""
    pause = case((Job.state == "queued", Job.not_before))
    left = select(Job.id, pause).where(Job.state.in_(LIVE)).order_by(pause.nulls_first()).limit(1)
    first = session.execute(left).first()
    return first is not None and (early or first[1] is None or first[1] <= moment(session))


def lease(
    session: Session,
    who: str,
    *,
    limits: Limits,
    is_gone: Callable[[str], bool] = lambda _: False,
    early: bool = False,
) -> Job | None:
    """Take the next job: one whose worker has died, else the one that has waited longest.

    Parameters
    ----------
    who : str
        Name of the worker.
    is_gone : callable
        Returns whether the worker of that name has certainly ended; its leases then end at once.
    early : bool
        Take also a job that was put off.

    Returns
    -------
    Job or None
        Now `running`, with a new fencing number; None when there is nothing to do.
    """
    running = select(Job).where(Job.state == "running").order_by(Job.id).with_for_update(skip_locked=True)
    at = moment(session)
    for job in session.scalars(running).all():
        if _is_held(job, is_gone, at=at):
            continue
        if job.cancel_wanted:
            _end(session, job, "cancelled")
        elif _is_hopeless(job, limits):
            _end(session, job, "failed", error=_died(job))
        else:
            return _given(job, who, at=at, limits=limits)
    oldest = _next_waiting(None if early else at)
    waiting = session.scalars(oldest.with_for_update(of=Job, skip_locked=True)).first()
    if waiting is None or not _has_turn(session, waiting):
        return None
    return _given(waiting, who, at=at, limits=limits)


def beat(session: Session, held: Lease, *, seconds: float, progress: tuple[int, int, str]) -> Job | None:
    """Renew a lease and record the progress.

    Parameters
    ----------
    seconds : float
        The lease lasts so much longer from now on.
    progress : (int, int, str)
        Steps done, steps in all, and what is being done.

    Returns
    -------
    Job or None
        The job, whose `cancel_wanted` may have been set; None when the lease is lost.
    """
    job = _held(session, held)
    if job is not None:
        done, total, job.note = progress
        job.done, job.total = min(done, total), total
        job.leased_until = moment(session) + timedelta(seconds=seconds)
    return job


def guard(session: Session, held: Lease) -> None:
    """Let a job's own changes of the database come about only while it holds its lease.

    Raises
    ------
    Conflict
        Another worker has taken over; nothing of the session must be kept.
    """
    if _held(session, held) is None:
        raise Conflict("another worker has taken over this job")


def finish(session: Session, held: Lease, *, result: Mapping[str, Any] | None = None) -> bool:
    """End a job as done; False when the lease is lost, and somebody else ends it."""
    job = _held(session, held)
    if job is not None:
        job.result = None if result is None else dict(result)
        _end(session, job, "done")
    return job is not None


def fail(session: Session, held: Lease, *, error: Mapping[str, str | None]) -> bool:
    """End a job as failed, with `message`, `where` and `hint`; False when the lease is lost."""
    job = _held(session, held)
    if job is not None:
        _end(session, job, "failed", error=dict(error))
    return job is not None


def stop(session: Session, held: Lease) -> bool:
    """End a job as cancelled; False when the lease is lost."""
    job = _held(session, held)
    if job is not None:
        _end(session, job, "cancelled")
    return job is not None


def give_back(session: Session, held: Lease) -> bool:
    """Put a job back into the queue because its worker has to stop; False when the lease is lost."""
    job = _held(session, held)
    if job is not None:
        job.started_at = None
        _queue_again(session, job)
    return job is not None


def put_off(session: Session, held: Lease, *, note: str, pause_s: float) -> bool:
    """Put a job back into the queue because something is away; False when the lease is lost.

    Until a pause is over, others are given. It doubles each time, up to five minutes.

    Parameters
    ----------
    note : str
        What is away, shown with the job.
    pause_s : float
        Seconds of the first pause.
    """
    job = _held(session, held)
    if job is not None:
        pause = min(max(pause_s, 1.0) * 2.0 ** min(job.waits, 20), _LONGEST_PAUSE_S)
        waiting = _queue_again(session, job)
        waiting.note, waiting.waits = note, job.waits + 1
        waiting.not_before = moment(session) + timedelta(seconds=pause)
    return job is not None


def let_go(session: Session, held: Lease) -> bool:
    """Leave a job to the next worker as if this one had died on it; False when the lease is lost already."""
    job = _held(session, held)
    if job is not None:
        job.leased_by = job.leased_until = None
    return job is not None


def _queue_again(session: Session, job: Job) -> Job:
    """Put a job back; returns it, or one like it that waits already."""
    job.attempts -= 1  # nobody died on it
    there = _waiting(session, job.kind, map_id=job.map_id, key=job.key)
    if job.cancel_wanted or there is not None:
        _end(session, job, "cancelled")
    else:
        job.state, job.leased_by, job.leased_until = "queued", None, None
    return there or job


def _waiting(session: Session, kind: str, *, map_id: int | None, key: str) -> Job | None:
    same = (Job.kind == kind, Job.map_id == map_id, Job.key == key, Job.state == "queued")
    return session.scalars(select(Job).where(*same).order_by(Job.id).limit(1).with_for_update()).first()


def _next_waiting(at: datetime | None) -> Select[Job]:
    """Select the oldest waiting job of a map on which no other is at work, with no pause by `at`."""
    other = aliased(Job)
    at_work = select(other.id).where(other.map_id == Job.map_id, other.state == "running").exists()
    since = func.coalesce(Job.started_at, Job.created_at)  # who was given back waits since it was tried
    found = select(Job).where(Job.state == "queued", ~at_work).order_by(since, Job.id).limit(1)
    return found if at is None else found.where(or_(Job.not_before.is_(None), Job.not_before <= at))


def _has_turn(session: Session, waiting: Job) -> bool:
    """Lock the map of a job, and see again whether another job is at work on it.

    Two workers may each find a job of one map. Nobody waits here, as an edit may in turn wait for the job.
    """
    if waiting.map_id is None:
        return True
    map_ = select(MapRecord.id).where(MapRecord.id == waiting.map_id).with_for_update(skip_locked=True)
    at_work = select(Job.id).where(Job.map_id == waiting.map_id, Job.state == "running")
    return session.scalar(map_) is not None and session.scalar(at_work.limit(1)) is None


def _is_held(job: Job, is_gone: Callable[[str], bool], *, at: datetime) -> bool:
    if job.leased_by is None or job.leased_until is None:
        return False
    return job.leased_until > at and not is_gone(job.leased_by)


def _is_hopeless(job: Job, limits: Limits) -> bool:
    """Count the death of a worker; work that gets on between deaths comes to its end."""
    if job.done > 0:
        job.attempts = 0
    return job.attempts >= limits.attempts or job.fence - job.waits >= 10 * limits.attempts


def _given(job: Job, who: str, *, at: datetime, limits: Limits) -> Job:
    job.state, job.leased_by = "running", who
    job.started_at, job.not_before = at, None
    job.leased_until = at + timedelta(seconds=limits.seconds)
    job.fence += 1
    job.attempts += 1
    job.done, job.total, job.note = 0, 0, ""
    return job


def _held(session: Session, held: Lease) -> Job | None:
    """Lock the job and find it as it is now; None when the lease is lost."""
    job = session.get(Job, held.job_id, with_for_update=True, populate_existing=True)
    return job if job is not None and job.state == "running" and job.fence == held.fence else None


def _end(session: Session, job: Job, state: str, *, error: dict[str, Any] | None = None) -> None:
    """End a job: all its steps are done exactly when the job is."""
    job.total = max(job.total, 1)
    job.done = job.total if state == "done" else min(job.done, job.total - 1)
    job.state, job.error, job.ended_at = state, error, moment(session)
    job.leased_by = job.leased_until = None


def _died(job: Job) -> dict[str, Any]:
    return {
        "message": f"the worker died {job.attempts or job.fence} times on this job",
        "where": None,
        "hint": "see the log of the server; if memory ran out, give the worker more, then try again",
    }
