"""Answers requests on a map, and queues the job that builds its index or its calibration.

A map with new photos answers at once, without them; a map without an index raises `NotReady` while it is
built. Both queue the same kind of job, one per method and features.
"""

from __future__ import annotations

from contextlib import suppress

from sqlalchemy.orm import Session

from webapp.core.features.table import Method, choose
from webapp.errors import IndexDamaged, NotReady, StorageError
from webapp.files.localize.calibration import FORMAT
from webapp.files.localize.global_model import usable_global_descriptor
from webapp.files.localize.models import second_look_features
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import job_views, jobs
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks import on_demand
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import LocalizeRequest, LocalizeResult

LANDMARKS_JOB = "landmarks"
"""Kind of the job that reconstructs landmarks from photos of a map."""

_OWN_JOB: tuple[Method, ...] = ("thorough", "landmarks")
"""Methods that need more than the index and the orientations, and have a calibration of their own."""


def localize_or_build(
    library: Library, record: MapRecord, *, cache: MapCache, request: LocalizeRequest, settings: Settings
) -> LocalizeResult:
    """Localize photos; if the index is missing or lacks photos, queue a build in the background.

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
        if not _build_index(library, record, method, features=features, settings=settings):
            raise
        raise NotReady(
            "the index of this map is being built",
            where=record.slug,
            hint="ask again in a moment; the list of jobs shows the progress",
        ) from error
    if result.opened.not_indexed:
        _build_index(library, record, method, features=features, settings=settings)
    if result.opened.to_calibrate:
        _calibrate(library, record, method, features=features, settings=settings)
    if result.form.get("note") == on_demand.NOT_YET:
        with suppress(StorageError):  # the answer is valid even if the disk is full
            _reconstruct_around(library, record, result, settings=settings)
    return result


def _reconstruct_around(
    library: Library, record: MapRecord, result: LocalizeResult, *, settings: Settings
) -> None:
    """Queue a reconstruction of the surroundings of the best place."""
    seeds = result.form["hypotheses"][0]["experiences"]
    opened = result.opened.pipeline.opened
    photos = on_demand.photos_around(opened, seeds, count=settings.landmarks.around_photos)
    key = f"around {seeds[0]}"
    with library.database.write() as session:
        jobs.enqueue(session, LANDMARKS_JOB, map_id=record.id, arguments={"photos": photos}, key=key)


def _build_index(
    library: Library, record: MapRecord, method: Method, *, features: str, settings: Settings
) -> bool:
    """Queue a build unless one is pending; return False for a map without placed photos or image."""
    with library.database.read() as session:
        row = session.get_one(MapRecord, record.id)
        if not maps.counts(session, row)[1] or row.satellite_path is None:
            return False
        at_work = _index_jobs(session, row.id, key=_job_key(method, features))
    if all(job.state in jobs.ENDED for job in at_work):
        _enqueue(library, record, method, features=features, settings=settings)
    return True


def _calibrate(
    library: Library, record: MapRecord, method: Method, *, features: str, settings: Settings
) -> None:
    """Queue a calibration, once per state of the map, and not while a job is pending or has just failed."""
    key = _job_key(method, features)
    with library.database.read() as session:
        at_work = _index_jobs(session, record.id, key=key)
        last = jobs.newest(session, record.id, kind=INDEX_JOB, key=key)
        tried = last is not None and last.arguments.get("state") == _state(session, record, settings)
    if not tried and all(job.state == "done" for job in at_work):
        _enqueue(library, record, method, features=features, settings=settings)


def _state(session: Session, record: MapRecord, settings: Settings) -> str:
    """Return a key of all that determines a job's result: with an equal key it need not run again."""
    revision = session.get_one(MapRecord, record.id).revision
    described = usable_global_descriptor(settings.models)
    weights = "" if described is None else f" {described.weights}"
    return f"{revision} {FORMAT} {second_look_features(settings.models)}{weights}"


def _job_key(method: Method, features: str) -> str:
    """Return the key of a job: one job per features serves all methods except those in `_OWN_JOB`."""
    if method in _OWN_JOB:
        return f"{features} {method}"
    return "" if features in ("auto", choose("verified").name) else features


def _index_jobs(session: Session, map_id: int, *, key: str) -> list[Job]:
    return [job for job in job_views.current(session, map_id) if job.kind == INDEX_JOB and job.key == key]


def _enqueue(
    library: Library, record: MapRecord, method: Method, *, features: str, settings: Settings
) -> None:
    key = _job_key(method, features)
    arguments = {"features": features, "method": method if method in _OWN_JOB else "verified"}
    if not key:
        arguments = {"features": "auto", "method": "auto"}
    with library.database.write() as session:
        arguments["state"] = _state(session, record, settings)
        jobs.enqueue(session, INDEX_JOB, map_id=record.id, arguments=arguments, key=key)
