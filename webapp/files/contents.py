"""The content of a library's files: in its folder, or in S3 with a pointer in the folder.

Readers and writers get a path that is local from here, and need not know of the object storage. Without a
storage (`connect` was not called, or the settings name none), all files are in the folder, and the functions
here work on them directly.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from platformdirs import user_cache_path

from webapp.errors import ObjectLost, StorageError, UsageError
from webapp.files.atomic import storage_error
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import (
    SUFFIX,
    ObjectCache,
    Pointer,
    pointed_path,
    pointer_path,
    read_pointer,
    write_pointer,
)
from webapp.files.object_storage.storage import ObjectStorage, check_marker, library_with_objects
from webapp.files.part_file import discard, move_in, sha256_of
from webapp.settings import Settings
from webapp.threads import ContextThreads

_TOGETHER = 4
"""Objects that are fetched in parallel, each in several parts; the connection pool allows for that."""

_LOCK = threading.Lock()

_used: list[ObjectStorage] = []
"""The storage of this process, if it has one."""


def use(storage: ObjectStorage | None) -> None:
    """Use a storage in this process from now on; None: read files from their paths."""
    _used[:] = [] if storage is None else [storage]


def in_use() -> ObjectStorage | None:
    """Return the storage of this process; None if files are read from their paths."""
    return _used[0] if _used else None


def reachable() -> bool:
    """Return whether the storage of this process responds, for a health check; True if there is none.

    The server has `PROBE_TIMEOUT_S` to respond; a failure is logged.
    """
    storage = in_use()
    return storage is None or storage.reachable()


def connect(settings: Settings) -> ObjectStorage | None:
    """Use the object storage of the settings in this process from now on; None if there is none.

    Raises:
        UsageError: The address is invalid, or the database is SQLite: machines that share photos must share
            the database, too.
        MissingPart: The extra `cluster` is not installed.
    """
    if settings.storage is None:
        if in_use() is not None:
            use(None)
        return None
    if settings.database is None:
        raise UsageError(
            "photos in an object storage need records in PostgreSQL",
            where="EXPMAP_STORAGE",
            hint="set EXPMAP_DATABASE, too; see docs/cluster.md",
        )
    with _LOCK:
        there, folder = in_use(), cache_folder(settings)
        if there is None or there.bucket.url != settings.storage or there.cache.folder != folder:
            bucket = Bucket(settings.storage)
            there = ObjectStorage(bucket, ObjectCache(folder, limit=int(settings.cache_gb * 1e9)))
            use(there)
    return there


def cache_folder(settings: Settings) -> Path:
    name = hashlib.sha256((settings.storage or "").encode()).hexdigest()[:16]
    return settings.cache_folder or user_cache_path("experience-map") / "objects" / name


def settings_at(path: Path, settings: Settings) -> Settings:
    """Return the settings for a map, whose storage is that of its library, or none."""
    inner = library_with_objects(path)
    if inner is None:
        return settings if settings.storage is None else replace(settings, storage=None)
    check_marker(inner, settings)
    return settings


def local(path: Path) -> Path:
    """Return a local path of a file's content, fetching it if it is an object; else the same path.

    Raises:
        StorageError: The storage cannot be reached, or the disk of the cache failed.
    """
    storage = in_use()
    pointer = read_pointer(path) if storage else None
    return path if storage is None or pointer is None else storage.fetch(path, pointer)


def fetch_together(paths: Sequence[Path]) -> None:
    """Fetch several files that are about to be read, in parallel; lost objects are ignored until read."""
    if in_use() is not None:
        with ContextThreads(_TOGETHER) as pool:
            for _ in pool.map(_fetch, paths):
                pass


def _fetch(path: Path) -> None:
    with suppress(ObjectLost):
        local(path)


@contextmanager
def read_once(path: Path) -> Iterator[Path]:
    """Yield a path like `local`, valid in the block only; an object that is not cached is not added.

    If a new file has been put at the path since it was stored, that is used instead of the object.
    """
    storage = in_use()
    pointer = read_pointer(path) if storage else None
    if storage is None or pointer is None or is_replaced(path, pointer):
        yield path
        return
    with storage.cache.read_once(
        pointer, name=path.name, fetch=lambda target: storage.bucket.get(pointer.key, target)
    ) as copy:
        yield copy


def is_replaced(path: Path, pointer: Pointer) -> bool:
    """Return whether a file exists next to its pointer, and differs from the stored one in size or time."""
    try:
        found = path.stat()
    except OSError:
        return False
    return (found.st_size, found.st_mtime_ns) != (pointer.bytes, pointer.mtime_ns)


def pointer_of(path: Path) -> Pointer | None:
    """Return the pointer of a file that is an object; None for any other."""
    return read_pointer(path) if in_use() else None


def shown_name(name: str) -> str:
    """Return the name of the file that a pointer replaces; other names unchanged."""
    return pointed_path(Path(name)).name if name.startswith(".") and name.endswith(SUFFIX) else name


def with_pointer(path: Path) -> tuple[Path, Path]:
    """Return the paths at which a file can be: its own, and that of its pointer."""
    return path, pointer_path(path)


def named_by(path: Path) -> Path | None:
    """Return the path itself, or if it is a pointer, that of its file; None for other hidden files."""
    if not path.name.startswith("."):
        return path
    return pointed_path(path) if path.suffix == SUFFIX and in_use() is not None else None


def is_there(path: Path) -> bool:
    """Return whether a file exists, without fetching it."""
    return path.is_file() or pointer_of(path) is not None


def facts_of(path: Path) -> tuple[int, int] | None:
    """Return a file's modification time (ns) and size in bytes, without fetching it; None if missing."""
    pointer = pointer_of(path)
    if pointer is not None:
        return pointer.mtime_ns, pointer.bytes
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_mtime_ns, found.st_size


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file, without fetching it."""
    pointer = pointer_of(path)
    return sha256_of(path) if pointer is None else pointer.sha256


def store(file: Path) -> Pointer | None:
    """Store a file's content, before anything refers to it, and cache it; None if there is no storage.

    Raises StorageUnavailable, DiskFull, StorageError.
    """
    storage = in_use()
    if storage is None:
        return None
    pointer = storage.store(file)
    storage.cache.adopt(file, pointer, name=file.name)
    return pointer


def put_in_place(file: Path, target: Path, *, pointer: Pointer) -> None:
    """Write the pointer of a file whose content was stored by `store`, and delete the file.

    This is fast, as nothing is copied: other writers may be waiting meanwhile.

    Raises:
        StorageError: Writing failed; the file has been kept.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    write_pointer(target, pointer)
    storage = in_use()
    if storage is not None:
        storage.cache.rename(pointer, before=file.name, name=target.name)
    discard(file)


def publish(path: Path) -> None:
    """Turn a file into an object, if there is a storage and the file exists.

    Raises:
        StorageUnavailable, DiskFull, StorageError: The file has been kept.
    """
    pointer = store(path) if path.is_file() else None
    if pointer is not None:
        put_in_place(path, path, pointer=pointer)


def settle(path: Path) -> None:
    """Turn a complete, computed file into an object, if it is in a library with a storage.

    Elsewhere it stays a file, as objects in use could not be distinguished from orphans.

    Raises:
        StorageUnavailable, DiskFull, StorageError: The file has been kept.
    """
    if in_use() is not None and library_with_objects(path) is not None:
        publish(path)


def bring_back(path: Path) -> None:
    """Turn an object into a file again, and delete its pointer; a new file at the path is kept.

    Raises:
        StorageUnavailable, ObjectLost, DiskFull, StorageError: The pointer has been kept.
    """
    pointer = read_pointer(path)
    if pointer is None:
        return
    if not path.is_file() or _is_same(path, pointer):
        # the same name each time, so that a killed process leaves no permanent leftovers
        part = path.with_name(f".{hashlib.sha256(path.name.encode()).hexdigest()[:16]}.part")
        with read_once(path) as copy:
            try:
                shutil.copyfile(copy, part)
                os.utime(part, ns=(pointer.mtime_ns, pointer.mtime_ns))
            except OSError as error:
                raise storage_error(error, where=str(path)) from error
            if sha256_of(part) != pointer.sha256:
                discard(part)
                raise StorageError(
                    "this copy of an object is damaged", where=str(copy), hint="delete it, and try again"
                )
        move_in(part, path)
    discard(pointer_path(path))


def _is_same(path: Path, pointer: Pointer) -> bool:
    """Return whether a file next to its pointer is the stored one, by size and time."""
    facts = path.stat()
    return (facts.st_size, facts.st_mtime_ns) == (pointer.bytes, pointer.mtime_ns)


def replaced(path: Path) -> None:
    """Delete the pointer of a file that was just written, so that its former object is no longer used."""
    if in_use() is not None:
        discard(pointer_path(path))


def remove(path: Path) -> None:
    """Delete a file and its pointer; the object is swept later, when nothing has referred to it for long."""
    discard(path)
    if in_use() is not None:
        discard(pointer_path(path))
