"""The background worker: takes jobs from the queue and runs them, one after the other.

Each job runs in a separate thread, so that the main thread can renew the lease and handle signals even while
a native library computes for seconds.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy import select

from webapp.errors import (
    Cancelled,
    ClusterUnavailable,
    DatabaseUnavailable,
    ExpMapError,
    FolderInUse,
    ProcessLost,
    StorageError,
    StorageUnavailable,
)
from webapp.files.atomic import storage_error, takes_nothing
from webapp.jobs.context import Context, JobProgress
from webapp.jobs.health import ProcessLock
from webapp.jobs.kinds import JobRegistry, Sweep
from webapp.logs import at_work
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lanes, Lease, Limits
from webapp.store.schema import Job, MapRecord
from webapp.tasks.find.queue_refresh import queue_refresh
from webapp.tasks.maps import delete_map, photo_files
from webapp.tasks.maps.export import export_late_maps
from webapp.tasks.operate import maintain_objects
from webapp.tasks.satellite import files
from webapp.tasks.video import add_video
from webapp.telemetry import span
from webapp.threads import ContextThreads

_log = logging.getLogger(__name__)
_TICK_S = 0.25
"""Interval at which changed progress is recorded."""

_IDLE_S = 0.5
_WATCH_S = 1.0
_CLEAN_S = 3600.0
_DATABASE_PAUSE_S = 1.0
_EXPORT_PAUSE_S = 5.0
"""Pause before map files whose export failed are tried again."""

_ELSEWHERE = (StorageUnavailable, ClusterUnavailable)
_PASSING = (*_ELSEWHERE, FolderInUse, DatabaseUnavailable)
"""Temporary errors: the job goes back to the queue, with a pause that doubles each time."""

_MOST_WAITS = 20
"""Maximum retries of a job (an hour or two) for a lock, or for the database, which may stay too slow."""

Work = Future[Mapping[str, Any] | None]


class Worker:
    """Runs the jobs of a library.

    Args:
        parent: Id of the process that started this one; the worker stops when it is gone.
        only_short: Whether it takes only short jobs, and leaves sweeps and the maps' files to other workers.
    """

    def __init__(
        self,
        library: Library,
        settings: Settings,
        *,
        registry: JobRegistry,
        parent: int | None = None,
        only_short: bool = False,
    ) -> None:
        self._library = library
        self._registry = registry
        self._settings = settings
        self._parent = parent
        self._lanes = Lanes(registry.short(), only_short)
        self._lock = ProcessLock(library.inner / "workers", short=only_short)
        self._stopping = threading.Event()
        self._stop_by = float("inf")
        self._clean_at = 0.0
        self._ended = threading.Event()

    def run(self, *, once: bool = False) -> None:
        """Run jobs until stopped."""
        exporter = threading.Thread(target=self._export, name="export", daemon=True)
        tends = not once and not self._lanes.only_short
        if tends:
            exporter.start()
            threading.Thread(target=self._store, name="store", daemon=True).start()
            threading.Thread(target=self._watch, name="watch", daemon=True).start()
        try:
            while not self._stops():
                try:
                    worked = self._turn(once=once)
                except DatabaseUnavailable as error:
                    if once:
                        raise
                    self._wait_for_database(error)
                    continue
                if not worked and once:
                    self._tidy_storage()
                    break
                if not worked:
                    self._stopping.wait(_IDLE_S)
        finally:
            self._ended.set()
            if tends:
                exporter.join(self._settings.jobs.stop_s)
            self._lock.release()

    def _turn(self, *, once: bool) -> bool:
        """Run due sweeps and the next job; returns whether there was one.

        Raises:
            StorageUnavailable, ClusterUnavailable, FolderInUse, DatabaseUnavailable: With `once`: the job
                failed temporarily, and is back in the queue.
        """
        if not self._lanes.only_short:
            self._clean()
        if once:
            export_late_maps(self._library)
            self._look()
        job = self._next(early=once)
        error = None if job is None else self._do(job, yields=not once)
        if once and isinstance(error, _PASSING):
            raise error  # otherwise it would be retried forever
        return job is not None

    def _wait_for_database(self, error: DatabaseUnavailable) -> bool:
        """Log the error and pause; returns whether to stop."""
        _log.warning("%s", error)
        return self._stopping.wait(_DATABASE_PAUSE_S)

    def stop_on_signals(self) -> None:
        """Install handlers: SIGINT and SIGTERM return the current job to the queue and stop the worker."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self.stop())

    def stop(self) -> None:
        """Stop soon; the current job goes back to the queue, and its finished steps are kept."""
        if not self._stopping.is_set():
            self._stopping.set()
            self._stop_by = time.monotonic() + self._settings.jobs.stop_s

    def _stops(self) -> bool:
        if self._parent is not None and os.getppid() != self._parent:
            self.stop()
        return self._stopping.is_set()

    def _export(self) -> None:
        """Keep the maps' files up to date even during long jobs, with a longer pause after a failure."""
        written = True
        while not self._ended.wait(self._settings.jobs.export_s if written else _EXPORT_PAUSE_S):
            try:
                written = export_late_maps(self._library)
            except DatabaseUnavailable as error:
                _log.warning("the maps' files could not be brought up to date: %s", error)
                written = False
            except Exception:  # noqa: BLE001 - the thread must outlive an error in one export
                _log.exception("the maps' files could not be brought up to date")
                written = False

    def _watch(self) -> None:
        """Look for what is due, even during long jobs."""
        while not self._ended.wait(_WATCH_S):
            self._look()

    def _look(self) -> None:
        for watch in self._registry.watches:
            try:
                watch(self._library, self._settings)
            except (ExpMapError, OSError) as error:
                _log.warning("what is due could not be looked for: %s", error)
            except Exception:  # noqa: BLE001 - the thread must outlive an error in one round
                _log.exception("what is due could not be looked for")

    def _store(self) -> None:
        """Maintain the object storage in the background; a stopping worker does not wait for it."""
        while True:
            self._tidy_storage()
            if self._ended.wait(_CLEAN_S):
                return

    def _tidy_storage(self) -> None:
        """Move photos into the object storage, and delete unreferenced objects."""
        stops = self._stopping.is_set
        try:
            maintain_objects.move_photos(self._library, stops=stops)
            maintain_objects.sweep_objects(self._library, self._settings, stops=stops)
        except (ExpMapError, OSError) as error:
            _log.warning("the object storage could not be kept in order: %s", error)
        except Exception:  # noqa: BLE001 - the thread must outlive an error in one round
            _log.exception("the object storage could not be kept in order")

    def _clean(self) -> None:
        """Run the sweeps every hour."""
        if time.monotonic() >= self._clean_at:
            delete_leftovers(self._library, self._settings, more=self._registry.sweeps)
            self._clean_at = time.monotonic() + _CLEAN_S

    def _next(self, *, early: bool) -> Job | None:
        with self._library.database.read() as session:
            if not jobs.anything_to_do(session, early=early):
                return None
        limits = Limits(self._settings.jobs.lease_s, self._settings.jobs.attempts)
        with self._library.database.write(locks_rows=True) as session:
            who, is_gone = self._lock.name, self._lock.is_gone
            return jobs.lease(session, who, limits=limits, lanes=self._lanes, is_gone=is_gone, early=early)

    def _do(self, job: Job, *, yields: bool) -> BaseException | None:
        """Run a job in a thread while renewing its lease; returns its error.

        Args:
            yields: Whether a job in the background makes room for one for which somebody waits.
        """
        _log.info("job %d (%s), attempt %d", job.id, job.kind, job.attempts)
        begun = time.monotonic()
        context = Context(
            library=self._library,
            settings=self._settings,
            progress=JobProgress(),
            lease=Lease(job.id, job.fence),
            map_id=job.map_id,
            account_id=job.account_id,
            arguments=job.arguments,
        )
        pool = ContextThreads(1, thread_name_prefix=f"job-{job.id}")
        with at_work(job=job.id):
            work: Work = pool.submit(self._work, job, context)
        heart = _Heartbeat(context, self._settings.jobs.lease_s, yields_in=self._lanes if yields else None)
        while not wait([work], timeout=_TICK_S).done:
            heart.beat()
            if self._stops():
                context.progress.stop()
            if time.monotonic() > self._stop_by:
                self._leave(context.lease)
        pool.shutdown()
        heart.beat(always=True)
        self._log_end(job, self._end(job, context, work), time.monotonic() - begun)
        if context.progress.cancelled():
            _sweep([partial(delete_map.delete_orphans, self._library)])
        return work.exception()

    def _work(self, job: Job, context: Context) -> Mapping[str, Any] | None:
        with span(f"job {job.kind}", job=job.id, attempt=job.attempts):
            return self._registry.function(job.kind)(context)

    def _leave(self, lease: Lease) -> None:
        """Exit the process in the middle of a long step, which the next worker repeats."""
        _log.warning("job %d does not stop in time, and is left as it is", lease.job_id)
        try:
            with self._library.database.write() as session:
                jobs.requeue(session, lease)
        except StorageError as error:
            _log.warning("job %d waits until its lease ends: %s", lease.job_id, error)
        os._exit(0)

    def _end(self, job: Job, context: Context, work: Work) -> str:
        """Record how a job ended, retrying while the database is unavailable; returns the outcome."""
        while True:
            try:
                return self._record(job, context, work)
            except DatabaseUnavailable as error:
                if self._wait_for_database(error):
                    raise

    def _record(self, job: Job, context: Context, work: Work) -> str:
        """Record how a job ended, unless its lease is lost; returns the outcome."""
        error, lease = work.exception(), context.lease
        with self._library.database.write() as session:
            if error is None:
                ended, kept = "done", jobs.finish(session, lease, result=work.result())
            elif isinstance(error, Cancelled) and (self._stopping.is_set() or context.progress.gives_way()):
                ended, kept = "given back", jobs.requeue(session, lease)
            elif isinstance(error, Cancelled):
                ended, kept = "cancelled", jobs.stop(session, lease)
            elif isinstance(error, _PASSING) and (job.waits < _MOST_WAITS or isinstance(error, _ELSEWHERE)):
                _log.warning("job %d (%s) waits: %s", job.id, job.kind, error)
                note, pause_s = error.message, error.wait_s
                ended, kept = "given back", jobs.postpone(session, lease, note=note, pause_s=pause_s)
            elif isinstance(error, ProcessLost):
                _log.warning("job %d (%s): %s", job.id, job.kind, error)
                ended, kept = "given back", jobs.release(session, lease)
            else:
                ended, kept = "failed", jobs.fail(session, lease, error=_error_json(error, job))
        return ended if kept else "taken over by another worker"

    def _log_end(self, job: Job, ended: str, seconds: float) -> None:
        fields = {
            "event": "job",
            "job": job.id,
            "kind": job.kind,
            "map": job.map_id,
            "account": job.account_id,
            "attempt": job.attempts,
            "state": ended,
            "seconds": round(seconds, 2),
        }
        level = logging.INFO if ended in ("done", "given back", "cancelled") else logging.WARNING
        _log.log(level, "job %d (%s): %s, %.1f s", job.id, job.kind, ended, seconds, extra={"fields": fields})


class _Heartbeat:
    """Renews a lease, records the progress, and passes on requests to cancel the job or to make room.

    Args:
        seconds: Duration of the lease.
        yields_in: The lanes of the worker; None: the job does not make room for others.
    """

    def __init__(self, context: Context, seconds: float, *, yields_in: Lanes | None = None) -> None:
        self._context = context
        self._seconds = seconds
        self._lanes = yields_in
        self._written: tuple[int, int, str] | None = None
        self._beat_at = 0.0

    def beat(self, *, always: bool = False) -> None:
        """Renew the lease if the progress has changed or a second has passed; notice requests to cancel."""
        progress, gives_way = self._context.progress.state(), False
        if not always and progress == self._written and time.monotonic() < self._beat_at:
            return
        try:
            with self._context.library.database.write(locks_rows=True) as session:
                job = jobs.beat(session, self._context.lease, seconds=self._seconds, progress=progress)
                if job is not None and self._lanes is not None:
                    gives_way = jobs.should_yield(session, self._context.lease, lanes=self._lanes)
        except StorageError as error:
            # The job continues: either the next beat is in time, or the lease is lost and it cannot write.
            _log.warning("the lease of job %d was not renewed: %s", self._context.lease.job_id, error)
            return
        if job is None or job.cancel_wanted:
            self._context.progress.stop()
        elif gives_way:
            self._context.progress.give_way()
        self._written, self._beat_at = progress, time.monotonic() + 1.0


def _error_json(error: BaseException, job: Job) -> dict[str, str | None]:
    """Return the error of a failed job in a form for users, and log it."""
    if isinstance(error, OSError) and takes_nothing(error):
        error = storage_error(error, where=Path(error.filename or "").name)
    if isinstance(error, ExpMapError):
        _log.warning("job %d (%s) failed: %s", job.id, job.kind, error)
        return {"message": error.message, "where": error.where, "hint": error.hint}
    _log.error("job %d (%s) failed: internal error", job.id, job.kind, exc_info=error)
    return {
        "message": f"internal error in job {job.id}",
        "where": None,
        "hint": "the server's log has the details; please report it",
    }


def delete_leftovers(library: Library, settings: Settings, *, more: Sequence[Sweep] = ()) -> None:
    """Delete leftovers of interrupted uploads and deletions, and queue jobs that are due."""
    with library.database.read() as session:
        ids = session.scalars(select(MapRecord.id)).all()
    sweeps: list[Callable[[], object]] = [partial(sweep, library, settings) for sweep in more]
    sweeps.append(partial(photo_files.sweep_uploads, library, settings=settings))
    sweeps.append(partial(add_video.sweep, library, settings))
    sweeps += [partial(photo_files.sweep_orphans, library, map_id=id) for id in ids]
    keep = timedelta(hours=settings.upload.keep_hours)
    sweeps += [partial(files.sweep, library, map_id=id, keep=keep) for id in ids]
    _sweep([*sweeps, partial(delete_map.delete_orphans, library), partial(queue_refresh, library)])


def _sweep(sweeps: Sequence[Callable[[], object]]) -> None:
    for sweep in sweeps:
        try:
            sweep()
        except (ExpMapError, OSError) as error:
            _log.warning("what was left behind could not be deleted: %s", error)
