"""Builds or updates the index beside a map.

Only what changed is computed, and a kill at any moment loses no finished photo.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.features.table import FeatureChoice
from webapp.core.mapmodel.model import Experience, Map
from webapp.errors import ExpMapError
from webapp.files.indexstore import IndexFolder, Manifest, PhotoRecord
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks import extract_photo, segments
from webapp.tasks.extract_photo import PhotoDone, PhotoJob

_IN_PROCESS = 4
"""So few photos are done here: starting worker processes takes longer."""


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What a build did.

    Attributes
    ----------
    folder : Path
        Of the index.
    photos : int
        In the map.
    extracted, reused, removed : int
        Photos computed now, taken over, and no longer in the map.
    failed : tuple of (int, str, str)
        Experience id, photo and reason.
    descriptors : int
        In the index, of photos in the map.
    seconds : float
    bytes : int
        On disk.
    """

    folder: Path
    photos: int
    extracted: int
    reused: int
    removed: int
    failed: tuple[tuple[int, str, str], ...]
    descriptors: int
    seconds: float
    bytes: int


@dataclass(frozen=True, slots=True)
class BuildRequest:
    """What to build.

    Attributes
    ----------
    map_folder : Path
        Photo paths are relative to it.
    map : Map
    folder : Path
        Of the index.
    choice : FeatureChoice
    jobs : int or None
        Worker processes; None for as many as there are cores.
    """

    map_folder: Path
    map: Map
    folder: Path
    choice: FeatureChoice
    jobs: int | None = None


def run(request: BuildRequest, *, settings: Settings, progress: Progress) -> BuildReport:
    """Bring the index up to the map.

    Every photo that is finished is on disk at once; segments are made of the finished photos in the map's
    order, so that an interrupted and continued build ends with the same files as an undisturbed one.

    Raises
    ------
    StorageError
        The disk refused, or another process is building.
    Cancelled
    IndexDamaged
        A file of the existing index cannot be read.
    """
    started = time.perf_counter()
    index = IndexFolder(request.folder)
    with writer_lock(request.folder):
        index.spool.mkdir(exist_ok=True)
        old = index.read_manifest() or Manifest(
            request.choice.detector, request.choice.extractor, settings.extract
        )
        changed = [
            e for e in request.map.experiences if not is_current(e, old, map_folder=request.map_folder)
        ]
        photos = {e.id: old.photos[e.id] for e in request.map.experiences if e.id in old.photos}
        path_of = {e.id: e.photo for e in request.map.experiences}
        extracted = 0
        progress.size(len(changed))
        for done in _describe_all(changed, request, settings=settings, progress=progress):
            photos[done.id] = _record(done, path_of[done.id])
            extracted += done.extracted
            progress.advance()
        ordered = {e.id: photos[e.id] for e in request.map.experiences}
        progress.note("joining")
        new = segments.join(index, replace(old, photos=ordered), kind=request.choice.kind, progress=progress)
        new = replace(new, build_seconds=round(old.build_seconds + time.perf_counter() - started, 3))
        if new.photos != old.photos or new.segments != old.segments:
            index.write_manifest(new)
        index.remove_unnamed(new)
    failed = tuple((i, p.photo, p.error) for i, p in new.photos.items() if p.error)
    return BuildReport(
        folder=request.folder,
        photos=len(ordered),
        extracted=extracted,
        reused=len(ordered) - extracted - len(failed),
        removed=len(old.photos.keys() - ordered.keys()),
        failed=failed,
        descriptors=sum(s.descriptors for s in new.segments),
        seconds=time.perf_counter() - started,
        bytes=index.bytes_on_disk(),
    )


def is_current(experience: Experience, manifest: Manifest, *, map_folder: Path) -> bool:
    """Tell whether the index holds the photo as it is on disk now, judged by path, size and time."""
    record = manifest.photos.get(experience.id)
    if record is None or record.photo != experience.photo or record.error:
        return False
    try:
        stat = (map_folder / experience.photo).stat()
    except OSError:
        return False
    return (record.bytes, record.mtime_ns) == (stat.st_size, stat.st_mtime_ns)


def _record(done: PhotoDone, photo: str) -> PhotoRecord:
    return PhotoRecord(photo, done.bytes, done.mtime_ns, done.content, done.error)


def _describe_all(
    changed: list[Experience], request: BuildRequest, *, settings: Settings, progress: Progress
) -> Iterator[PhotoDone]:
    """Describe photos, in worker processes when there are many; yields each as it is finished."""
    tasks = (
        PhotoJob(e.id, request.map_folder / e.photo, request.folder, request.choice, settings)
        for e in changed
    )
    jobs = request.jobs or available_cores()
    if jobs == 1 or len(changed) <= _IN_PROCESS:
        for task in tasks:
            progress.check()
            yield extract_photo.run(task)
        return
    yield from _in_processes(tasks, min(jobs, len(changed)), progress)


def _in_processes(tasks: Iterable[PhotoJob], jobs: int, progress: Progress) -> Iterator[PhotoDone]:
    # Spawned, not forked: OpenCV and Faiss have threads that a fork would leave half alive.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=extract_photo.start_worker)
    waiting: set[Future[PhotoDone]] = set()
    todo = iter(tasks)
    try:
        while True:
            # A short queue bounds the memory and lets a cancelled build stop within a few photos.
            while len(waiting) < 4 * jobs and (task := next(todo, None)) is not None:
                waiting.add(pool.submit(extract_photo.run, task))
            if not waiting:
                return
            finished, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
            progress.check()
    except BrokenProcessPool as error:
        raise ExpMapError(
            "a worker process was killed",
            hint="probably for lack of memory; run the build again, with fewer --jobs",
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def available_cores() -> int:
    """Count the cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
