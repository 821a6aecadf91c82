"""The job that computes the landmarks of a map, or aligns them with it again."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks.show_cloud import VERSION
from webapp.web.context import library

_JOB = "landmarks"
_JOBS = (_JOB, "place-rest")
"""Kinds of jobs that compute landmarks."""
_LAY = f"lay-{VERSION}"
"""Job key of the alignment; as it has the version, a failure of an older version is tried again."""


def queue_landmarks(record: MapRecord, *, only_lay: bool, account_id: int | None) -> None:
    """Queue the job unless it is already waiting."""
    with library().database.write() as session:
        jobs.enqueue(
            session,
            _JOB,
            map_id=record.id,
            account_id=account_id,
            arguments={"only_lay": only_lay},
            key=_LAY if only_lay else "",
        )


def queue_for_visitors(record: MapRecord) -> None:
    """Queue an alignment for no account, unless the last since the map's change failed or was cancelled."""
    with library().database.read() as session:
        last = jobs.newest(session, record.id, kind=_JOB, key=_LAY)
    if last is None or last.state not in ("failed", "cancelled") or last.created_at < record.changed_at:
        queue_landmarks(record, only_lay=True, account_id=None)


def running_job(session: Session, record: MapRecord) -> int | None:
    """Return the id of a queued or running job that computes landmarks of a map, if there is one."""
    running = select(Job.id).where(Job.map_id == record.id, Job.kind.in_(_JOBS), Job.state.not_in(ENDED))
    return session.scalars(running.limit(1)).first()
