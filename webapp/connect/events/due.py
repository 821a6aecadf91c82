"""Finds receivers with events to deliver, and forgets what is old; without the libraries that deliver."""

from __future__ import annotations

from datetime import datetime, timedelta

from sqlalchemy import Select, delete, exists, or_, select

from webapp.jobs.kinds import JobRegistry, Kind
from webapp.settings import Settings
from webapp.store import outbox
from webapp.store.clock import now
from webapp.store.database import moment
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.outbox import EventDelivery, EventReceiver
from webapp.store.schema import Job

LONGEST_PAUSE = timedelta(hours=1)
"""Before a receiver that has failed is tried again."""

_AFTER_A_CRASH = timedelta(minutes=1)
"""Pause before a receiver whose job itself has failed."""

_KEEP = timedelta(days=30)
_KEEP_JOBS = timedelta(days=1)
_KEEP_UNCONFIRMED = timedelta(days=2)


def queue_due(library: Library, _settings: Settings) -> None:
    """Queue a job for each receiver that has events waiting and no job."""
    with library.database.read() as session:
        if not session.scalars(_due(moment(session))).all():
            return
    with library.database.write() as session:
        for id in session.scalars(_due(moment(session))).all():
            jobs.enqueue(session, outbox.DELIVERY_JOB, arguments={"receiver": id}, key=str(id))


def _due(at: datetime) -> Select[int]:
    waiting = exists().where(
        EventDelivery.receiver_id == EventReceiver.id, EventDelivery.state == outbox.WAITING
    )
    crashed = (Job.state == "failed") & (Job.ended_at > at - _AFTER_A_CRASH)
    has_job = select(Job.key).where(Job.kind == outbox.DELIVERY_JOB, or_(Job.state.in_(jobs.LIVE), crashed))
    try_at = EventReceiver.try_at
    # one that is due later than that was put off before the clock was set back
    is_due = or_(try_at.is_(None), try_at <= at, try_at > at + LONGEST_PAUSE)
    receiver_key = EventReceiver.id.cast(Job.key.type)
    return select(EventReceiver.id).where(waiting, is_due, receiver_key.not_in(has_job))


def sweep(library: Library, _settings: Settings) -> None:
    """Delete old messages, addresses that nobody confirmed, and the jobs of deliveries."""
    with library.database.write() as session:
        session.execute(delete(EventDelivery).where(EventDelivery.ended_at < now() - _KEEP))
        forgotten = EventReceiver.created_at < now() - _KEEP_UNCONFIRMED
        session.execute(delete(EventReceiver).where(EventReceiver.confirmed_at.is_(None), forgotten))
        old = (Job.kind == outbox.DELIVERY_JOB, Job.ended_at < moment(session) - _KEEP_JOBS)
        session.execute(delete(Job).where(*old))


JOBS = JobRegistry(
    kinds={outbox.DELIVERY_JOB: Kind("webapp.connect.events.delivering:deliver", short=True)},
    sweeps=(sweep,),
    watches=(queue_due,),
)
