"""Restores a library from a backup.

All files are first unpacked to a staging folder inside the target and compared with the backup's manifest,
and the database is checked. Only then are they moved into place; an old library goes to a subfolder.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sqlalchemy import select

from webapp.core.mapmodel.findings import quoted
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import Conflict, InputError, UsageError
from webapp.files.atomic import storage_error, sync_folder, write_text
from webapp.files.backup import read_manifest, unpack
from webapp.files.lock import any_alive
from webapp.progress import Progress
from webapp.store.clock import now
from webapp.store.database import Database
from webapp.store.library import DATABASE, INNER, SERVER, open_library
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.moving import marks
from webapp.store.moving.copying import copy_records, prepare
from webapp.store.operate import jobs, snapshot
from webapp.store.operate.snapshot import SnapshotContents
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.operate.backup import MAPS, QUERIES, LibraryPart, readers

_STAGE = ".restoring"
_BEFORE = ".before-restore-"


@dataclass(frozen=True, slots=True)
class RestoreReport:
    """What was restored."""

    made_at: str  # When the backup was made, ISO 8601
    maps: int
    photos: int
    files: int
    before: Path | None  # Folder with the previous library


def restore(
    archive: Path,
    folder: Path,
    *,
    parts: Sequence[LibraryPart],
    url: str | None = None,
    force: bool = False,
    progress: Progress,
) -> RestoreReport:
    """Restore a library.

    Indexes are not part of a backup: the first worker builds them.

    Args:
        folder: Folder of the library; created if missing.
        parts: Parts of the library with files, apart from maps.
        url: Address of an empty database for the records, instead of a SQLite file in the folder.
        force: Restore even if the folder is not empty; its contents are kept in a folder of their own.
        progress: One step per file.

    Raises:
        UsageError: The folder or the database is not empty.
        Conflict: A server or a worker is running on the library.
        InputError: The file is not a backup, or is damaged; nothing was changed.
        StorageError, DiskFull: The disk failed.
        Cancelled
    """
    folder = folder.absolute()
    manifest = read_manifest(archive)
    stage, there, key = folder / _STAGE, _there(folder), f"restore into {folder}"
    if there and not force:
        raise UsageError(
            "the folder is not empty",
            where=str(folder),
            hint=_hint(url, key=key),
        )
    _check_idle(folder)
    try:
        shutil.rmtree(stage, ignore_errors=True)  # left by a killed restore
        stage.mkdir(parents=True)
        try:
            progress.note("unpacking")
            files = _unpack(archive, stage, parts, progress=progress)
            contents = _prepare(stage, parts)
            with _records_in(url, stage, key=key, progress=progress):
                before = _swap(folder, stage, there)
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    except OSError as error:
        raise storage_error(error, where=str(folder)) from error
    return RestoreReport(str(manifest.get("made_at")), len(contents.maps), contents.photos, files, before)


def _hint(url: str | None, *, key: str) -> str:
    """Return the hint for a folder that is not empty, perhaps filled by an earlier restore."""
    if url is not None:
        with closing(Database(url)) as target, target.moving() as connection:
            if marks.filling_key(connection) == key:
                return "an earlier restore was stopped just before its end: repeat it with --force"
    return "choose an empty one, or --force, which keeps what is there under another name"


def _there(folder: Path) -> list[Path]:
    """List the contents of the folder, except those left by earlier restores."""
    if not folder.exists():
        return []
    if not folder.is_dir():
        raise UsageError("this is not a folder", where=str(folder))
    return [p for p in folder.iterdir() if p.name != _STAGE and not p.name.startswith(_BEFORE)]


def _check_idle(folder: Path) -> None:
    if any_alive(folder / INNER / "workers"):
        raise Conflict(
            "a server or a worker is running on this library", where=str(folder), hint="stop it first"
        )


def _unpack(archive: Path, stage: Path, parts: Sequence[LibraryPart], *, progress: Progress) -> int:
    """Unpack a backup as a library; return the number of its files."""

    folders = {MAPS: stage, QUERIES: stage / INNER / QUERIES}
    folders |= {part.name: stage / part.folder for part in parts}

    def place(name: str) -> Path:
        kind, _, rest = name.partition("/")
        if name == DATABASE:
            return stage / INNER / DATABASE
        if kind not in folders or "/" not in rest or rest.startswith("."):
            raise InputError("the backup holds files that are not part of a library", where=name)
        return folders[kind] / PurePosixPath(rest)

    files = unpack(archive, stage, place=place, progress=progress)
    if DATABASE not in files:
        raise InputError("the backup has no database", where=str(archive))
    return len(files)


def _prepare(stage: Path, parts: Sequence[LibraryPart]) -> SnapshotContents:
    """Check the database, migrate it, and queue jobs that build the indexes."""
    contents = snapshot.check(stage / INNER / DATABASE, readers=readers(parts))
    _check_names(contents)
    library = open_library(stage)
    try:
        with library.database.write() as session:
            placed = select(Photo.map_id).where(Photo.x_px.is_not(None), ~Photo.removed)
            wanted = (
                MapRecord.satellite_path.is_not(None),
                MapRecord.binned_at.is_(None),
                MapRecord.id.in_(placed),
            )
            for map_id in session.scalars(select(MapRecord.id).where(*wanted)):
                jobs.enqueue(session, INDEX_JOB, map_id=map_id)
    finally:
        library.database.close()
    return contents


@contextmanager
def _records_in(url: str | None, stage: Path, *, key: str, progress: Progress) -> Iterator[None]:
    """Copy the records to a server before the block, and release them for use after it."""
    if url is None:
        yield
        return
    file = stage / INNER / DATABASE
    with closing(Database(url)) as target:
        with closing(Database(f"sqlite:///{file}")) as source, source.moving() as connection:
            prepare(target, key=key, again=True)
            copy_records(connection, target, progress=progress)
        file.unlink()
        write_text(stage / INNER / SERVER, f"{target.name}\n")
        yield
        with target.moving() as written:
            marks.unmark_filling(written)


def _check_names(contents: SnapshotContents) -> None:
    """Refuse a database with file paths outside its folders, so that its users need not check each path."""
    for name in contents.names():
        if name_problem(name):
            raise InputError(
                "the backup names files that are not in its folders",
                where=quoted(name),
                hint="restore a backup that you have made yourself",
            )


def _swap(folder: Path, stage: Path, there: list[Path]) -> Path | None:
    """Move the new library to its place, by renaming only, the database last."""
    before = _free_folder(folder) if there else None
    moves = [(path, before / path.name) for path in there if before is not None]
    moves += [(path, folder / path.name) for path in sorted(stage.iterdir(), key=lambda p: p.name == INNER)]
    if before is not None:
        before.mkdir()
    done = []
    try:
        for path, target in moves:
            path.rename(target)
            done.append((path, target))
    except OSError:
        for path, target in reversed(done):
            target.rename(path)
        raise
    sync_folder(folder)
    return before


def _free_folder(folder: Path) -> Path:
    """Return a free path for the previous library; restores may follow each other within a second."""
    name = f"{_BEFORE}{now():%Y%m%dT%H%M%S}"
    further = (f"{name}-{number}" for number in itertools.count(2))
    return next(path for path in (folder / n for n in itertools.chain([name], further)) if not path.exists())
