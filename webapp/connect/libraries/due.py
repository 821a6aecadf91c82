"""Finds linked albums whose update is due; without the libraries that update them."""

from __future__ import annotations

from datetime import datetime, timedelta

from sqlalchemy import Select, or_, select

from webapp.jobs.kinds import JobRegistry, Kind
from webapp.settings import Settings
from webapp.store.database import moment
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.photo_libraries import LinkedAlbum, PhotoLibrary
from webapp.store.schema import Job

JOB = "photo-library"
"""The kind of the jobs that update an album."""

_LONGEST = timedelta(days=8)
"""Longer than each interval: one that is due later was put off before the clock was set back."""


def queue_due(library: Library, _settings: Settings) -> None:
    """Queue a job for each album whose update is due, unless it has one."""
    with library.database.read() as session:
        if not session.execute(_due(moment(session))).all():
            return
    with library.database.write() as session:
        for album, account_id in session.execute(_due(moment(session))).all():
            album.due_at = moment(session) + timedelta(hours=album.every_h)
            arguments = {"album": album.id}
            jobs.enqueue(
                session,
                JOB,
                map_id=album.map_id,
                account_id=account_id,
                arguments=arguments,
                key=str(album.id),
            )


def _due(at: datetime) -> Select[LinkedAlbum, int]:
    has_job = select(Job.key).where(Job.kind == JOB, Job.state.in_(jobs.LIVE))
    is_due = or_(LinkedAlbum.due_at <= at, LinkedAlbum.due_at > at + _LONGEST)
    return (
        select(LinkedAlbum, PhotoLibrary.account_id)
        .join(PhotoLibrary, PhotoLibrary.id == LinkedAlbum.library_id)
        .where(LinkedAlbum.every_h > 0, is_due, LinkedAlbum.id.cast(Job.key.type).not_in(has_job))
    )


JOBS = JobRegistry(
    kinds={JOB: Kind("webapp.connect.libraries.updating:update_album", short=True)}, watches=(queue_due,)
)
