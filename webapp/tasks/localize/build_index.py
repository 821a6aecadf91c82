"""Builds or updates the index next to a map.

Only new and changed photos are processed, and a killed build keeps all finished photos.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.features.table import FeatureChoice
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.views import level_views, picture_name
from webapp.errors import IndexDamaged
from webapp.files.listing import normal_name
from webapp.files.localize.index_store import IndexFolder, Manifest, PhotoRecord, remove_outdated
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.localize import extract_photo, segments
from webapp.tasks.localize.extract_photo import PhotoDone, PhotoJob, size_and_time
from webapp.tasks.localize.open_map import BuildReport
from webapp.tasks.localize.segments import coding_of

_IN_PROCESS = 4
"""Up to this many photos are processed in this process: starting workers would take longer."""

_MOST_OF_ONE_SIZE = 100


def count_reasons(failed: Iterable[tuple[str, str]]) -> str:
    """Count why photos could not be used, the most frequent reason first.

    Args:
        failed: Photo and reason; the reason may contain the photo's name.

    Returns:
        "58 photos: file not found, such as photos/1.jpg; 1 photo: it is not an image, such as photos/9.jpg".
    """
    photos: dict[str, list[str]] = {}
    for photo, reason in failed:
        photos.setdefault(reason.replace(repr(photo), "it").partition("; ")[0], []).append(photo)
    most_first = sorted(photos.items(), key=lambda item: -len(item[1]))
    return "; ".join(
        f"{len(found)} photo{'s' * (len(found) != 1)}: {reason}, such as {found[0]}"
        for reason, found in most_first
    )


@dataclass(frozen=True, slots=True)
class BuildRequest:
    """What to build."""

    cfg: Path  # The map; photo paths are relative to its folder
    map: Map
    folder: Path  # Index folder
    choice: FeatureChoice
    jobs: int | None = None  # Worker processes; None for as many as there are cores


def update_index(request: BuildRequest, *, settings: Settings, progress: Progress) -> BuildReport:
    """Update the index to the current map.

    Each finished photo is written at once; segments are joined from the finished photos in the map's order,
    so that a resumed build yields the same files as an uninterrupted one. Missing or damaged index files are
    rebuilt.

    Raises:
        StorageError: A file cannot be written, or another process is building the index.
        Cancelled
    """
    started = time.perf_counter()
    index = IndexFolder(request.folder)
    with writer_lock(request.folder):
        index.make_spool()
        before = _manifest(index, request, settings=settings, progress=progress)
        coding = coding_of(index, request.choice.engine or before.engine, kind=request.choice.kind)
        old = segments.intact(index, before, coding=coding)
        if old != before and coding.engine == before.engine:
            progress.note("files of the index are missing or damaged: rebuilding them")
        photos, extracted = _photos(old, request, settings=settings, progress=progress)
        new = segments.join(
            index, replace(old, photos=photos), coding=coding, settings=settings, progress=progress
        )
        index.publish(new)
        if new != before:
            spent = before.build_seconds + time.perf_counter() - started
            index.write_manifest(replace(new, build_seconds=round(spent, 3)))
        index.remove_unnamed(new)
        remove_outdated(request.folder.parent)
    failed = tuple((i, p.photo, p.error) for i, p in photos.items() if p.error)
    return BuildReport(
        folder=request.folder,
        photos=len(photos),
        extracted=extracted,
        reused=len(photos) - extracted - len(failed),
        removed=len(before.photos.keys() - photos.keys()),
        failed=failed,
        descriptors=segments.descriptors_in_map(index, new),
        seconds=time.perf_counter() - started,
        bytes=index.bytes_on_disk(),
    )


def _manifest(
    index: IndexFolder, request: BuildRequest, *, settings: Settings, progress: Progress
) -> Manifest:
    """Read the manifest; an empty one if it is missing or damaged."""
    try:
        manifest = index.read_manifest()
    except IndexDamaged as error:
        progress.note(f"{error.message}: rebuilding the index")
        manifest = None
    return manifest or Manifest(request.choice.detector, request.choice.extractor, settings.extract)


def _photos(
    old: Manifest, request: BuildRequest, *, settings: Settings, progress: Progress
) -> tuple[dict[int, PhotoRecord], int]:
    """Process new and changed photos; return the records in the map's order and the number extracted."""
    folder = request.cfg.parent
    pictures = level_views(request.map.experiences)
    changed = [e for e in pictures if not is_current(e, old, map_folder=folder)]
    name_of = {e.id: picture_name(e) for e in changed}
    described: dict[int, PhotoRecord] = {}
    extracted = 0
    progress.size(len(changed))
    for done in describe_all(changed, old, request=request, settings=settings, progress=progress):
        described[done.id] = PhotoRecord(
            name_of[done.id], done.bytes, done.mtime_ns, done.content, done.error
        )
        extracted += done.extracted
        if done.extracted or done.error:
            progress.advance()
        else:
            progress.skip()
    return {e.id: described.get(e.id) or old.photos[e.id] for e in pictures}, extracted


def is_current(experience: Experience, manifest: Manifest, *, map_folder: Path) -> bool:
    """Check whether the index holds the photo as it is on disk now, judged by path, size and time."""
    record = manifest.record_of(experience.id, picture_name(experience))
    if record is None or record.error:
        return False
    return (record.bytes, record.mtime_ns) == size_and_time(map_folder / experience.photo)


def describe_all(
    changed: list[Experience],
    old: Manifest,
    *,
    request: BuildRequest,
    settings: Settings,
    progress: Progress,
) -> Iterator[PhotoDone]:
    """Process photos, many of them in worker processes or on Dask; yield each result when it is done.

    A file that several lines name is processed once.
    """
    alike: dict[Hashable, list[Experience]] = {}
    for e in changed:
        alike.setdefault((normal_name(e.photo), e.view, e.blurred), []).append(e)
    firsts = [group[0] for group in alike.values()]
    others = {first.id: group[1:] for first, group in zip(firsts, alike.values(), strict=True)}
    tasks = _tasks(firsts, old, request=request, settings=settings)
    at = ExecutionTarget(settings, request.folder, "processes", request.jobs)
    if len(firsts) <= _IN_PROCESS:
        at = at.on_this_machine()
    for done in in_order(extract_photo.extract_one, tasks, shared=None, at=at, progress=progress):
        yield done
        for other in others[done.id]:
            yield replace(done, id=other.id, extracted=False)


def _tasks(
    changed: list[Experience], old: Manifest, *, request: BuildRequest, settings: Settings
) -> Iterator[PhotoJob]:
    # A renamed, copied or touched photo has the same content, and hence the same size.
    of_size: dict[int, list[str]] = {}
    for record in old.photos.values():
        if record.content:
            of_size.setdefault(record.bytes, []).append(record.content)
    for e in changed:
        size, _ = size_and_time(request.cfg.parent / e.photo)
        same = of_size.get(size, [])
        # If many photos have equal size (no compression), the size does not narrow them down.
        indexed = tuple(same) if len(same) <= _MOST_OF_ONE_SIZE else ()
        yield PhotoJob(
            e.id,
            request.cfg,
            e.photo,
            request.folder,
            request.choice,
            settings,
            indexed,
            e.view,
            () if e.view is not None else e.blurred,
        )
