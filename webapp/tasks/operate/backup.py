"""Backs up a whole library to one file, while it is in use, and restores it.

The database is copied as a snapshot, together with the exported files of the maps and other files that are
replaced in place; their writers wait during that. All other files are photos and images, which are immutable
and copied afterwards. If files have disappeared by then, because a map was permanently deleted, the copy is
repeated from a later snapshot.

To restore, all files are first unpacked to a staging folder inside the target and compared with the backup's
manifest, and the database is checked. Only then are they moved into place; an old library goes to a
subfolder.
"""

from __future__ import annotations

import itertools
import shutil
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Protocol

from filelock import FileLock, Timeout
from sqlalchemy import select

from webapp import __version__
from webapp.core.mapmodel.findings import quoted
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import Conflict, InputError, ObjectLost, StorageError, UsageError
from webapp.files.atomic import storage_error, sync_folder, write_text
from webapp.files.backup import Archive, new_backup, read_manifest, unpack
from webapp.files.contents import in_use, named_by, read_once
from webapp.files.lock import allow_open_files, any_alive
from webapp.progress import Progress
from webapp.store import queries
from webapp.store.clock import now
from webapp.store.database import Database
from webapp.store.library import DATABASE, INNER, SERVER, Library, open_library
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.moving import marks
from webapp.store.moving.copying import copy_records, prepare
from webapp.store.operate import jobs, snapshot
from webapp.store.operate.snapshot import PartContents, Reader, SnapshotContents
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import export
from webapp.tasks.operate.open_storage import refuse_objects

MAPS = "maps"
QUERIES = "queries"
"""Layout of a backup: `library.db`, `maps/SLUG/...`, `queries/ID/...`, `PART/ID/...`."""

_DERIVED = "derived"
_EXPORTED = frozenset({".cfg", ".json"})
_WAIT_S = 60
_OTHER_FILES = 256
"""Files open at a time, in addition to a lock per map."""

_TRIES = 5


class LibraryPart(Protocol):
    """Files of one kind of record, in `FOLDER/ID/...` of the library and `NAME/ID/...` of a backup."""

    @property
    def name(self) -> str:
        """First path component of its files in a backup."""

    @property
    def folder(self) -> str:
        """Folder relative to the library."""

    def contents(self, database: sqlite3.Connection) -> PartContents:
        """Read the ids of the records, and the files that they need."""

    def locks(self, library: Library) -> Iterable[tuple[Path, str]]:
        """Return the lock files of writers that replace files, each with what it protects."""

    def replaced(self, library: Library, id: int) -> Iterable[Path]:
        """Return the files of a record that are replaced in place; they need not exist."""


def readers(parts: Iterable[LibraryPart]) -> Mapping[str, Reader]:
    """Return, by part, the function that reads its contents from a copy of the database."""
    return {part.name: part.contents for part in parts}


@dataclass(frozen=True, slots=True)
class BackupReport:
    maps: int
    photos: int
    files: int
    size_bytes: int  # Total size of the files
    missing: tuple[str, ...]  # Files that are missing from the library itself


@dataclass(frozen=True, slots=True)
class _Snapshot:
    contents: SnapshotContents
    replaced: dict[str, bytes]
    """Contents of the files that are replaced in place, by name in the backup."""


def back_up(
    library: Library, target: Path, *, parts: Sequence[LibraryPart], progress: Progress
) -> BackupReport:
    """Back up a library.

    Derived files (`derived/`), unfinished uploads and the key that signs sessions are left out.

    Args:
        target: Backup file; an existing one is replaced when the new one is complete.
        parts: Parts of the library with files, apart from maps.

    Raises:
        UsageError: The file would be in the library itself, or photos of the library are in S3 and this
            process has not opened its storage.
        StorageError, DiskFull: The disk or the object storage failed; an older backup of that name is
            unchanged.
    """
    if in_use() is None:
        refuse_objects(library.inner, doing="this backup")
    target = target.absolute()
    if target.resolve().is_relative_to(library.folder):
        raise UsageError(
            "a backup inside the library would be lost with it",
            where=str(target),
            hint="choose another folder",
        )
    about = {"made_at": now().isoformat(timespec="seconds"), "made_by": __version__}
    with new_backup(target, about=about, progress=progress) as archive:
        copying = _Copying(library, archive, parts)
        moment, missing = copying.copy(progress=progress)
        archive.add(DATABASE, archive.scratch)
        for name, data in moment.replaced.items():
            archive.add_bytes(name, data)
        contents = moment.contents
        archive.keep(lambda name: _belongs(name, contents))
        files = archive.files
        size = sum(kept.size_bytes for kept in files.values())
        report = BackupReport(len(contents.maps), contents.photos, len(files), size, tuple(sorted(missing)))
        progress.note("reading it again")
    return report


class _Copying:
    """Copies one library into one archive."""

    def __init__(self, library: Library, archive: Archive, parts: Sequence[LibraryPart]) -> None:
        self._library = library
        self._archive = archive
        self._parts = parts

    def copy(self, *, progress: Progress) -> tuple[_Snapshot, set[str]]:
        """Copy a snapshot and its files; if files disappear meanwhile, repeat with a later snapshot."""
        missing: set[str] = set()
        for _ in range(_TRIES):
            progress.note("copying")
            moment = self._moment()
            before, missing = missing, self._copy_files(moment, progress=progress)
            if missing <= before:  # missing again: the library has lost these files before
                break
        return moment, missing

    def _moment(self) -> _Snapshot:
        """Copy the database and, consistent with it, the files that are replaced in place."""
        library = self._library
        with library.database.engine.connect() as connection:
            slugs = {str(slug) for (slug,) in connection.exec_driver_sql("SELECT slug FROM map")}
        allow_open_files(len(slugs) + _OTHER_FILES)
        with ExitStack() as writers:
            for slug in sorted(slugs):
                writers.enter_context(_no_export(library.map_folder(slug)))
            for part in self._parts:
                for lock, what in part.locks(library):
                    writers.enter_context(_held(lock, what=what, where=part.name))
            contents = snapshot.copy_to(library.database, self._archive.scratch, readers=readers(self._parts))
            if not set(contents.maps.values()) <= slugs:  # a new map, whose writers were not locked out
                writers.close()
                return self._moment()
            return _Snapshot(contents, dict(self._replaced(contents)))

    def _replaced(self, contents: SnapshotContents) -> Iterator[tuple[str, bytes]]:
        """Read the files that are replaced in place, each with its name in the backup."""
        for slug in contents.maps.values():
            for path in _exported(self._library, slug):
                yield f"{MAPS}/{slug}/{path.name}", path.read_bytes()
        for part in self._parts:
            for id in sorted(contents.parts[part.name].ids):
                for path in part.replaced(self._library, id):
                    with suppress(FileNotFoundError):  # never written, or being deleted
                        yield f"{part.name}/{id}/{path.name}", path.read_bytes()

    def _copy_files(self, moment: _Snapshot, *, progress: Progress) -> set[str]:
        """Copy the immutable files; return the names of missing ones."""
        found = {name: path for name, path in self._files(moment.contents) if name not in moment.replaced}
        needed = {f"{MAPS}/{slug}/{path}" for slug, path in moment.contents.files}
        needed |= {f"{QUERIES}/{map_id}/{file}" for map_id, file in moment.contents.queries}
        for name, part in moment.contents.parts.items():
            needed |= {f"{name}/{id}/{path}" for id, path in part.files}
        progress.size(len(found))
        for name, path in found.items():
            progress.check()
            try:
                with read_once(path) as copy:
                    self._archive.add(name, copy)
            except (FileNotFoundError, ObjectLost):
                continue  # deleted since it was listed, or lost
            progress.advance()
        return {name for name in needed if name not in self._archive.files}

    def _files(self, contents: SnapshotContents) -> Iterator[tuple[str, Path]]:
        library = self._library
        for slug in contents.maps.values():
            folder = library.map_folder(slug)
            for path in sorted(path for path in folder.rglob("*") if path.is_file()):
                inside, named = path.relative_to(folder), named_by(path)
                if named is not None and inside.parts[0] != _DERIVED:
                    yield f"{MAPS}/{slug}/{named.relative_to(folder).as_posix()}", named
        for map_id in contents.maps:
            folder = queries.folder(library, map_id)
            for file in sorted(file for id, file in contents.queries if id == map_id):
                yield f"{QUERIES}/{map_id}/{file}", folder / file
        for part in self._parts:
            for id, name in sorted(contents.parts[part.name].files):
                yield f"{part.name}/{id}/{name}", library.folder / part.folder / str(id) / name


@contextmanager
def _no_export(folder: Path) -> Iterator[None]:
    """Hold the lock of a map's exported files; a map without a folder has none."""
    with ExitStack() as stack:
        try:
            (folder / _DERIVED).mkdir(exist_ok=True)
            path = folder / _DERIVED / export.LOCK
            stack.enter_context(_held(path, what="the .cfg file of a map", where=folder.name))
        except FileNotFoundError:
            pass  # no folder yet, or it is being deleted
        yield


@contextmanager
def _held(path: Path, *, what: str, where: str) -> Iterator[None]:
    """Hold the lock of the writers of `what`, who hold it for short times only."""
    with ExitStack() as stack:
        try:
            stack.enter_context(FileLock(path, timeout=_WAIT_S))
        except Timeout as error:
            raise StorageError(
                f"the backup waited {_WAIT_S} s for {what}, which is still being written",
                where=where,
                hint="try again",
            ) from error
        yield


def _exported(library: Library, slug: str) -> list[Path]:
    """List the files of a map that are replaced in place."""
    folder = library.map_folder(slug)
    return [
        p for p in folder.glob("*") if p.suffix in _EXPORTED and p.is_file() and not p.name.startswith(".")
    ]


def _belongs(name: str, contents: SnapshotContents) -> bool:
    """Return False for a file of a record that was deleted while it was copied."""
    kind, _, rest = name.partition("/")
    owner = rest.partition("/")[0]
    owners = {MAPS: set(contents.maps.values()), QUERIES: {str(id) for id in contents.maps}}
    owners |= {part: {str(id) for id in found.ids} for part, found in contents.parts.items()}
    return not rest or owner in owners[kind]


_STAGE = ".restoring"
_BEFORE = ".before-restore-"


@dataclass(frozen=True, slots=True)
class RestoreReport:
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

    Raises:
        UsageError: The folder or the database is not empty.
        Conflict: A server or a worker is running on the library.
        InputError: The file is not a backup, or is damaged; nothing was changed.
        StorageError, DiskFull: The disk failed.
    """
    folder = folder.absolute()
    manifest = read_manifest(archive)
    stage, there, key = folder / _STAGE, _content_of(folder), f"restore into {folder}"
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


def _content_of(folder: Path) -> list[Path]:
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
