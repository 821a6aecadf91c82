"""Answers requests on a map, and queues the job that builds its index or its calibration.

A map with new photos answers at once, without them; a map without an index raises `NotReady` while it is
built. Both queue the same kind of job, one per method and features.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.features.table import Method, choose
from webapp.errors import IndexDamaged, NotReady, StorageError
from webapp.files.localize.calibration import FORMAT
from webapp.files.localize.models import second_look_features, usable_global_descriptor
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import job_views, jobs
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks import on_demand
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import LocalizeRequest, LocalizeResult

LANDMARKS_JOB = "landmarks"
"""Kind of the job that reconstructs landmarks from photos of a map."""

_OWN_JOB: tuple[Method, ...] = ("thorough", "landmarks")
"""Methods that need more than the index and the orientations, and have a calibration of their own."""


def localize_or_build(cache: MapCache, record: MapRecord, *, request: LocalizeRequest) -> LocalizeResult:
    """Localize photos; if the index is missing or lacks photos, queue a build in the background.

    Raises:
        NotReady: The index is being built.
        PhotoError, UsageError, MapError, NotFound
    """
    builder = _Builder(cache.library, record, cache.settings, request.options)
    try:
        result = upload.localize_uploads(cache, record.id, request=request)
    except (NotReady, IndexDamaged) as error:
        if not builder.build_index():
            raise
        raise being_built(record) from error
    if result.opened.not_indexed:
        builder.build_index()
    if result.opened.to_calibrate:
        builder.calibrate()
    if result.form.get("note") == on_demand.NOT_YET:
        with suppress(StorageError):  # the answer is valid even if the disk is full
            builder.reconstruct_around(result)
    return result


def build_first(library: Library, record: MapRecord, *, settings: Settings) -> bool:
    """Have the index of a map built before other long work, as a photo waits for it.

    Returns:
        Whether it is being built; False for a map without placed photos or image.
    """
    return _Builder(library, record, settings, OpenOptions()).build_index()


def being_built(record: MapRecord) -> NotReady:
    return NotReady(
        "the index of this map is being built",
        where=record.slug,
        hint="ask again in a moment; the list of jobs shows the progress",
    )


@dataclass(frozen=True, slots=True)
class _Builder:
    """Queues jobs for the method and features of a request."""

    library: Library
    record: MapRecord
    settings: Settings
    options: OpenOptions

    def build_index(self) -> bool:
        """Queue a build unless one is pending, and let it come first; return False if there is none to do."""
        with self.library.database.read() as session:
            row = session.get_one(MapRecord, self.record.id)
            if not maps.counts(session, row)[1] or row.satellite_path is None:
                return False
            pending = [job.id for job in self._at_work(session) if job.state in jobs.LIVE]
        if not pending:
            self._enqueue()
            return True
        with self.library.database.write() as session:
            for job in session.scalars(select(Job).where(Job.id.in_(pending))):
                jobs.ask(session, job)
        return True

    def calibrate(self) -> None:
        """Queue a calibration, once per state of the map, unless a job is pending or has just failed."""
        with self.library.database.read() as session:
            at_work = self._at_work(session)
            last = jobs.newest(session, self.record.id, kind=INDEX_JOB, key=self._key)
            tried = last is not None and last.arguments.get("state") == self._state(session)
        if not tried and all(job.state == "done" for job in at_work):
            self._enqueue(asked=False)

    def reconstruct_around(self, result: LocalizeResult) -> None:
        """Queue a reconstruction of the surroundings of the best place."""
        seeds = result.form["hypotheses"][0]["experiences"]
        opened, count = result.opened.pipeline.opened, self.settings.landmarks.around_photos
        arguments = {"photos": on_demand.photos_around(opened, seeds, count=count)}
        with self.library.database.write() as session:
            job = jobs.enqueue(
                session, LANDMARKS_JOB, map_id=self.record.id, arguments=arguments, key=f"around {seeds[0]}"
            )
            jobs.ask(session, job)

    @property
    def _features(self) -> str:
        """Name of the features; `auto` for the default ones of the library."""
        method, features = self.options.method, self.options.features
        return "auto" if method == features == "auto" else self.options.choose(method).name

    @property
    def _key(self) -> str:
        """Key of a job: one job per features serves all methods except those in `_OWN_JOB`."""
        if self.options.method in _OWN_JOB:
            return f"{self._features} {self.options.method}"
        return "" if self._features in ("auto", choose("verified").name) else self._features

    def _state(self, session: Session) -> str:
        """Return a key of all that determines a job's result: with an equal key it need not run again."""
        revision = session.get_one(MapRecord, self.record.id).revision
        described = usable_global_descriptor(self.settings.models)
        weights = "" if described is None else f" {described.weights}"
        return f"{revision} {FORMAT} {second_look_features(self.settings.models)}{weights}"

    def _at_work(self, session: Session) -> list[Job]:
        current = job_views.current(session, self.record.id)
        return [job for job in current if job.kind == INDEX_JOB and job.key == self._key]

    def _enqueue(self, *, asked: bool = True) -> None:
        """Queue the job; with `asked` it comes first, as a photo waits for it."""
        method = self.options.method if self.options.method in _OWN_JOB else "verified"
        arguments = {"features": self._features, "method": method}
        if not self._key:
            arguments = {"features": "auto", "method": "auto"}
        with self.library.database.write() as session:
            arguments["state"] = self._state(session)
            job = jobs.enqueue(session, INDEX_JOB, map_id=self.record.id, arguments=arguments, key=self._key)
            job.urgent = True
            if asked:
                jobs.ask(session, job)
