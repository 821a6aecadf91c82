"""Answers requests on a map, and queues the job that its index or its calibration needs first.

A map that photos were added to answers at once, without them; one that was never built says that it is being
built. Both are one kind of job, which exists once for each method and features.
"""

from __future__ import annotations

from sqlalchemy.orm import Session

from webapp.core.features.table import Method
from webapp.errors import IndexDamaged, NotReady
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import jobs
from webapp.store.schema import Job, MapRecord
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache, MethodChoice
from webapp.tasks.localize.upload import LocalizeRequest, LocalizeResult


def localize_or_build(
    library: Library, record: MapRecord, *, cache: MapCache, request: LocalizeRequest, settings: Settings
) -> LocalizeResult:
    """Localize photos; where the index is missing or lacks photos, have it built in the background.

    Raises
    ------
    NotReady
        The index is being built.
    PhotoError, UsageError, MapError, NotFound
    """
    method, features = request.choice.resolved()
    try:
        result = upload.localize_uploads(cache, record.id, request=request, settings=settings)
    except (NotReady, IndexDamaged) as error:
        if not _build_index(library, record, features):
            raise
        raise NotReady(
            "the index of this map is being built",
            where=record.slug,
            hint="ask again in a moment; the list of jobs shows the progress",
        ) from error
    if result.opened.not_indexed:
        _build_index(library, record, features)
    if result.opened.to_calibrate:
        _calibrate(library, record, method, features=features)
    return result


def _build_index(library: Library, record: MapRecord, features: str) -> bool:
    """Queue a build unless there is one; return False for a map that has nothing to build from."""
    with library.database.read() as session:
        row = session.get_one(MapRecord, record.id)
        if not maps.counts(session, row)[1] or row.satellite_path is None:
            return False
        at_work = _index_jobs(session, row.id, key=_job_key("verified", features))
    if all(job.state in jobs.ENDED for job in at_work):
        _enqueue(library, record, "verified", features=features)
    return True


def _calibrate(library: Library, record: MapRecord, method: Method, *, features: str) -> None:
    """Queue a calibration for a method, but not again at once after one that failed."""
    with library.database.read() as session:
        at_work = _index_jobs(session, record.id, key=_job_key(method, features))
    if all(job.state == "done" for job in at_work):
        _enqueue(library, record, method, features=features)


def _job_key(method: Method, features: str) -> str:
    other = "" if features == MethodChoice().resolved()[1] else features
    return other if method == "verified" else f"{features} {method}"


def _index_jobs(session: Session, map_id: int, *, key: str) -> list[Job]:
    return [job for job in jobs.current(session, map_id) if job.kind == INDEX_JOB and job.key == key]


def _enqueue(library: Library, record: MapRecord, method: Method, *, features: str) -> None:
    arguments, key = {"features": features, "method": method}, _job_key(method, features)
    with library.database.write() as session:
        jobs.enqueue(session, INDEX_JOB, map_id=record.id, arguments=arguments, key=key)
