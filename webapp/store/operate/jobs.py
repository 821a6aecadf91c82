"""Jobs: long work outside a request, in a queue.

The worker of a job holds a lease and renews it. A job whose lease has expired is taken over by the next
worker that asks, with a higher fencing number; the worker that lost the lease can no longer write about the
job (Kleppmann, "How to do distributed locking", 2016).

Short work, for which somebody waits, does not wait behind long work: it comes first, and has workers of its
own. Long work for which a photo waits to be localized comes next. Of one map, at most one short and one long
job run at a time.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, Select, case, false, func, or_, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, aliased

from webapp.errors import Conflict, NotFound
from webapp.store import outbox
from webapp.store.database import moment
from webapp.store.schema import Job, MapRecord

ENDED = ("done", "failed", "cancelled")
LIVE = ("queued", "running")

_LONGEST_PAUSE = timedelta(minutes=5)
"""Of a job that is put off. One that is due later was put off before the clock was set back."""

_PATIENCE = timedelta(minutes=30)
"""A job that has waited for this long is neither overtaken nor interrupted any more."""

_YIELD_AFTER = timedelta(seconds=3)
"""For how long an urgent job waits for a free worker before a job in the background makes room."""

_MOST_YIELDS = 3
"""How often a job makes room, as some of its work may have to be repeated."""

_MOST_YIELDS_TO_PHOTOS = 10
"""The same, for a job without which a photo cannot be localized."""

_ASKED_WITHIN = timedelta(minutes=5)
"""For how long somebody who sent a photo is assumed to wait, unless they send it again."""


@dataclass(frozen=True, slots=True)
class Lease:
    """The right to write about a job, until another worker takes it over."""

    job_id: int
    fence: int  # The job's fencing number when the lease was given


@dataclass(frozen=True, slots=True)
class Limits:
    """The duration of a lease, and the number of workers that may die on a job."""

    seconds: float  # Duration of a lease that is not renewed
    # A job fails after this many workers in a row have died on it without a step done; and after ten times as
    # many leases in total (those put off not counted), as it would never finish.
    attempts: int


@dataclass(frozen=True, slots=True)
class Lanes:
    """Which kinds of jobs are short, and whether a worker takes only these."""

    short: frozenset[str] = frozenset()
    only_short: bool = False


EITHER = Lanes()


def enqueue(
    session: Session,
    kind: str,
    *,
    map_id: int | None = None,
    account_id: int | None = None,
    arguments: Mapping[str, Any] | None = None,
    key: str = "",
) -> Job:
    """Queue a job, or return an equal one that is already waiting.

    Args:
        session: A writing one; the job is committed together with all else in it.
        kind: Kind of work.
        map_id, account_id: The map that it is about, and the account that wants it.
        arguments: JSON values for the work.
        key: Waiting jobs with the same map, kind and key are merged.
    """
    urgent = account_id is not None
    if (there := _waiting(session, kind, map_id=map_id, key=key)) is not None:
        there.urgent = there.urgent or urgent
        return there  # locked, so that no worker starts it before this session is committed
    job = Job(
        kind=kind,
        map_id=map_id,
        account_id=account_id,
        key=key,
        arguments=dict(arguments or {}),
        urgent=urgent,
    )
    try:
        with session.begin_nested():
            session.add(job)
    except IntegrityError:
        # Another session was faster, if the database allows concurrent writers.
        there = _waiting(session, kind, map_id=map_id, key=key)
        if there is None:
            raise
        return there
    return job


def key_of(arguments: Mapping[str, Any]) -> str:
    """Return a key that only jobs with equal arguments share."""
    return hashlib.sha256(json.dumps(arguments, sort_keys=True).encode()).hexdigest()


def ask(session: Session, job: Job) -> None:
    """Note that a photo cannot be localized before a job is done: it comes before other long work."""
    job.urgent, job.asked_at = True, moment(session)


def find(session: Session, id: int) -> Job:
    """Find a job. Raises NotFound."""
    job = session.get(Job, id)
    if job is None:
        raise NotFound(f"job {id} not found", hint="reload the page")
    return job


def list_jobs(session: Session, *, map_id: int | None = None, limit: int = 50) -> list[Job]:
    """List the jobs of a map, or of the library, newest first."""
    found = select(Job) if map_id is None else select(Job).where(Job.map_id == map_id)
    return list(session.scalars(found.order_by(Job.id.desc()).limit(limit)))


def newest(session: Session, map_id: int | None, *, kind: str, key: str) -> Job | None:
    """Find the last job of a kind and key that was queued for a map, or for none."""
    wanted = select(Job).where(Job.map_id == map_id, Job.kind == kind, Job.key == key)
    return session.scalar(wanted.order_by(Job.id.desc()).limit(1))


def cancel(session: Session, job: Job) -> None:
    """Cancel a waiting job, or ask the worker of a running one to stop; do nothing if it has ended."""
    if job.state == "queued":
        _end(session, job, "cancelled")
    elif job.state == "running":
        job.cancel_wanted = True


def retry(session: Session, job: Job) -> Job:
    """Queue a failed or cancelled job again; return it, or an equal one that is already waiting."""
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
    """Return whether a job is running, or waiting and due: only then is it worth asking for a lease."""
    pause = case((Job.state == "queued", Job.not_before))
    left = select(Job.id, pause).where(Job.state.in_(LIVE)).order_by(pause.nulls_first()).limit(1)
    first = session.execute(left).first()
    if first is None or early or first[1] is None:
        return first is not None
    return not timedelta(0) < first[1] - moment(session) <= _LONGEST_PAUSE


def lease(
    session: Session,
    who: str,
    *,
    limits: Limits,
    lanes: Lanes = EITHER,
    is_gone: Callable[[str], bool] = lambda _: False,
    early: bool = False,
) -> Job | None:
    """Take the next job: one whose worker has died, else the one whose turn it is.

    Short jobs come first, then those for which a photo waits, then those that somebody started; among these,
    the one that has waited longest.

    Args:
        who: Name of the worker.
        lanes: Which jobs are short, and whether the worker takes only these.
        is_gone: Returns whether the worker of that name has certainly ended; its leases then end at once.
        early: Whether to also take a job that was put off.

    Returns:
        Now `running`, with a new fencing number; None if there is nothing to do.
    """
    running = select(Job).where(Job.state == "running", *_taken(lanes)).order_by(Job.id)
    at = moment(session)
    for job in session.scalars(running.with_for_update(skip_locked=True)).all():
        if job.leased_until is not None:  # it was given for longer only if the clock has been set back since
            job.leased_until = min(job.leased_until, at + timedelta(seconds=limits.seconds))
        if _is_held(job, is_gone, at=at):
            continue
        if job.cancel_wanted:
            _end(session, job, "cancelled")
        elif _is_hopeless(job, limits):
            _end(session, job, "failed", error=_died(job))
        else:
            return _given(job, who, at=at, limits=limits)
    following = _next_waiting(lanes, at=at, early=early)
    waiting = session.scalars(following.with_for_update(of=Job, skip_locked=True)).first()
    if waiting is None or not _has_turn(session, waiting, lanes=lanes):
        return None
    return _given(waiting, who, at=at, limits=limits)


def beat(session: Session, held: Lease, *, seconds: float, progress: tuple[int, int, str]) -> Job | None:
    """Renew a lease and record the progress.

    Args:
        seconds: New duration of the lease from now on.
        progress: Steps done, total steps, and a note on the current one.

    Returns:
        The job, whose `cancel_wanted` may have been set; None if the lease is lost.
    """
    job = _held(session, held)
    if job is not None:
        done, total, job.note = progress
        job.done, job.total = min(done, total), total
        job.leased_until = moment(session) + timedelta(seconds=seconds)
    return job


def should_yield(session: Session, held: Lease, *, lanes: Lanes) -> bool:
    """Return whether a long job should make room for one that matters more to somebody who waits.

    One in the background makes room for one that somebody started, both for one for which a photo waits.
    """
    job, at = session.get(Job, held.job_id), moment(session)
    if job is None or job.kind in lanes.short or job.created_at < at - _PATIENCE:
        return False
    if job.asked_at is not None and job.asked_at > at - _ASKED_WITHIN:
        return False
    yields = job.fence - job.waits
    if yields > _MOST_YIELDS_TO_PHOTOS:
        return False
    wanted = Job.urgent if not job.urgent and yields <= _MOST_YIELDS else _is_asked(at)
    late = (wanted, Job.created_at < at - _YIELD_AFTER)
    following = _next_waiting(lanes, at=at, early=False, after=job.id)
    return session.scalars(following.where(*late)).first() is not None


def guard(session: Session, held: Lease) -> None:
    """Lock a job and check its lease, so that the session's changes are committed only under that lease.

    Raises:
        Conflict: Another worker has taken over; the session must be rolled back.
    """
    if _held(session, held) is None:
        raise Conflict("another worker has taken over this job")


def finish(session: Session, held: Lease, *, result: Mapping[str, Any] | None = None) -> bool:
    """End a job as done; False if the lease is lost, so that this worker may not end it."""
    job = _held(session, held)
    if job is not None:
        job.result = None if result is None else dict(result)
        _end(session, job, "done")
    return job is not None


def fail(session: Session, held: Lease, *, error: Mapping[str, str | None]) -> bool:
    """End a job as failed, with `message`, `where` and `hint`; False if the lease is lost."""
    job = _held(session, held)
    if job is not None:
        _end(session, job, "failed", error=dict(error))
    return job is not None


def stop(session: Session, held: Lease) -> bool:
    """End a job as cancelled; False if the lease is lost."""
    job = _held(session, held)
    if job is not None:
        _end(session, job, "cancelled")
    return job is not None


def requeue(session: Session, held: Lease) -> bool:
    """Put a job back into the queue because its worker has to stop; False if the lease is lost."""
    job = _held(session, held)
    if job is not None:
        job.started_at = None
        _queue_again(session, job)
    return job is not None


def postpone(session: Session, held: Lease, *, note: str, pause_s: float) -> bool:
    """Put a job back into the queue because something is unavailable; False if the lease is lost.

    It is not due before a pause is over, which doubles each time, up to five minutes.

    Args:
        note: What is unavailable, shown with the job.
        pause_s: Seconds of the first pause.
    """
    job = _held(session, held)
    if job is not None:
        pause = min(max(pause_s, 1.0) * 2.0 ** min(job.waits, 20), _LONGEST_PAUSE.total_seconds())
        waiting = _queue_again(session, job)
        waiting.note, waiting.waits = note, job.waits + 1
        waiting.not_before = moment(session) + timedelta(seconds=pause)
    return job is not None


def release(session: Session, held: Lease) -> bool:
    """Release a job to the next worker, as if this one had died on it; False if the lease is already lost."""
    job = _held(session, held)
    if job is not None:
        job.leased_by = job.leased_until = None
    return job is not None


def _queue_again(session: Session, job: Job) -> Job:
    """Put a job back into the queue; return it, or an equal one that is already waiting."""
    job.attempts -= 1  # no worker died on it
    there = _waiting(session, job.kind, map_id=job.map_id, key=job.key)
    if job.cancel_wanted or there is not None:
        _end(session, job, "cancelled")
    else:
        job.state, job.leased_by, job.leased_until = "queued", None, None
    return there or job


def _waiting(session: Session, kind: str, *, map_id: int | None, key: str) -> Job | None:
    same = (Job.kind == kind, Job.map_id == map_id, Job.key == key, Job.state == "queued")
    return session.scalars(select(Job).where(*same).order_by(Job.id).limit(1).with_for_update()).first()


def _next_waiting(lanes: Lanes, *, at: datetime, early: bool, after: int | None = None) -> Select[Job]:
    """Select the waiting job whose turn it is: due, unless `early`, and no other of its map and lane runs.

    Args:
        after: A running job that is considered ended.
    """
    other = aliased(Job)
    same = (other.kind.in_(lanes.short) == Job.kind.in_(lanes.short), other.id != (after or 0))
    at_work = select(other.id).where(other.map_id == Job.map_id, other.state == "running", *same).exists()
    since = func.coalesce(Job.started_at, Job.created_at)  # one that was put off waits since its last start
    first = or_(Job.kind.in_(lanes.short), since < at - _PATIENCE)
    rank = case((first, 0), (_is_asked(at), 1), (Job.urgent, 2), else_=3)
    before_set_back = case((since > at, 0), else_=1)  # the clock has been set back since
    found = select(Job).where(Job.state == "queued", ~at_work, *_taken(lanes))
    if not early:
        due = (Job.not_before.is_(None), Job.not_before <= at, Job.not_before > at + _LONGEST_PAUSE)
        found = found.where(or_(*due))
    return found.order_by(rank, before_set_back, since, Job.id).limit(1)


def _is_asked(at: datetime) -> ColumnElement[bool]:
    """Return the condition on a job that a photo which was sent lately waits for it."""
    return func.coalesce(Job.asked_at > at - _ASKED_WITHIN, false())


def _taken(lanes: Lanes) -> tuple[ColumnElement[bool], ...]:
    """Return the condition on the jobs that a worker takes."""
    return (Job.kind.in_(lanes.short),) if lanes.only_short else ()


def _has_turn(session: Session, waiting: Job, *, lanes: Lanes) -> bool:
    """Lock the map of a job, and check again that no other job of the map and lane is running.

    Two workers may each find a job of one map. The lock is not waited for: its holder, an edit, may itself
    be waiting for the lock of the job.
    """
    if waiting.map_id is None:
        return True
    map_ = select(MapRecord.id).where(MapRecord.id == waiting.map_id).with_for_update(skip_locked=True)
    running = select(Job.kind).where(Job.map_id == waiting.map_id, Job.state == "running")
    if session.scalar(map_) is None:
        return False
    is_short = waiting.kind in lanes.short
    return all((kind in lanes.short) != is_short for kind in session.scalars(running))


def _is_held(job: Job, is_gone: Callable[[str], bool], *, at: datetime) -> bool:
    if job.leased_by is None or job.leased_until is None:
        return False
    return job.leased_until > at and not is_gone(job.leased_by)


def _is_hopeless(job: Job, limits: Limits) -> bool:
    """Return whether too many workers have died on a job; after progress the count starts again."""
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
    """Lock the job and reload it; None if the lease is lost."""
    job = session.get(Job, held.job_id, with_for_update=True, populate_existing=True)
    return job if job is not None and job.state == "running" and job.fence == held.fence else None


def _end(session: Session, job: Job, state: str, *, error: dict[str, Any] | None = None) -> None:
    """End a job; `done` equals `total` if and only if the job is done."""
    job.total = max(job.total, 1)
    job.done = job.total if state == "done" else min(job.done, job.total - 1)
    job.state, job.error, job.ended_at = state, error, moment(session)
    job.leased_by = job.leased_until = None
    if state == "failed":
        outbox.job_failed(session, job, error=error or {})


def _died(job: Job) -> dict[str, Any]:
    return {
        "message": f"the worker died {job.attempts or job.fence} times on this job",
        "where": None,
        "hint": "see the log of the server; if memory ran out, give the worker more, then try again",
    }
