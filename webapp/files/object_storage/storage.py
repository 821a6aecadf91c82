"""Where the content of a library's files is: in its folder, or in S3 with a pointer in the folder.

Without a storage (`use` was not called) the path of a file is where it is, and every function here does what
was done before there were objects.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import secrets
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from webapp.errors import ObjectLost, StorageError, StorageUnavailable
from webapp.files.atomic import storage_error
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import ObjectCache
from webapp.files.object_storage.marker import is_kept_in_objects
from webapp.files.object_storage.pointer import (
    SUFFIX,
    Pointer,
    pointed_path,
    pointer_path,
    read_pointer,
    write_pointer,
)
from webapp.files.part_file import discard, move_in, sha256_of
from webapp.threads import ContextThreads

_log = logging.getLogger(__name__)

_LOOK_S = 5.0

_TOGETHER = 4
"""Objects that are fetched at the same time, each of them in pieces; as many connections are kept open."""


class ObjectStorage:
    """Objects in a bucket, and copies of some in a cache."""

    def __init__(self, bucket: Bucket, cache: ObjectCache) -> None:
        self.bucket = bucket
        self.cache = cache
        self._answers, self._looked_at, self._looking = True, -math.inf, threading.Lock()

    def store(self, file: Path) -> Pointer:
        """Store the content of a file under a key of its own, which nothing names yet.

        Raises
        ------
        StorageUnavailable, DiskFull
        StorageError
            The disk refused, or the file was changed meanwhile: nothing names what was stored of it.
        """
        facts = file.stat()
        sha256 = sha256_of(file)
        pointer = Pointer(
            # Not the hash alone: what is swept as an orphan is never what comes again at the same moment.
            f"{sha256[:2]}/{sha256}-{secrets.token_hex(8)}",
            sha256,
            facts.st_size,
            facts.st_mtime_ns,
        )
        try:
            self.bucket.put(pointer.key, file)
        except StorageUnavailable:
            _check_unchanged(file, facts)  # its checksum may be that of the file before
            raise
        _check_unchanged(file, facts)
        return pointer

    def reachable(self) -> bool:
        """Return whether the server answers and lets us in; asks it once in `_LOOK_S` seconds at most."""
        with self._looking:
            if time.monotonic() >= self._looked_at + _LOOK_S:
                try:
                    self.bucket.probe()
                    self._answers = True
                except StorageError:  # which is in the log
                    self._answers = False
                self._looked_at = time.monotonic()
            return self._answers

    def fetch(self, path: Path, pointer: Pointer) -> Path:
        """Give a readable copy of an object; errors as `ObjectCache.path` and `Bucket.get`."""
        try:
            return self.cache.path(
                pointer, name=path.name, fetch=lambda target: self.bucket.get(pointer.key, target)
            )
        except ObjectLost as error:
            _log.warning("%s: %s", path, error.message)
            raise


_used: list[ObjectStorage] = []
"""The storage of this process, if it has one."""


def use(storage: ObjectStorage | None) -> None:
    """Take the content of files from a storage from now on; None: from where their paths lead."""
    _used[:] = [] if storage is None else [storage]


def in_use() -> ObjectStorage | None:
    """Return the storage of this process; None where files are where their paths lead."""
    return _used[0] if _used else None


def reachable() -> bool:
    """Return whether the storage of this process answers, for a check of health; True where it has none.

    The server has `PROBE_TIMEOUT_S` to answer, and the log says why it counts as away.
    """
    storage = in_use()
    return storage is None or storage.reachable()


@contextmanager
def using(storage: ObjectStorage | None) -> Iterator[None]:
    """Use a storage in the block."""
    before = in_use()
    use(storage)
    try:
        yield
    finally:
        use(before)


def local(path: Path) -> Path:
    """Return where the content of a file can be read now; the same path, where it is no object.

    Raises
    ------
    StorageError
        The storage cannot be reached, or the disk of the cache refused.
    """
    storage = in_use()
    pointer = read_pointer(path) if storage else None
    return path if storage is None or pointer is None else storage.fetch(path, pointer)


def fetch_together(paths: Sequence[Path]) -> None:
    """Fetch several files that are about to be read, some at a time; one that is lost is left to its reader.

    Raises
    ------
    StorageError
        As `local`.
    """
    if in_use() is not None:
        with ContextThreads(_TOGETHER) as pool:
            for _ in pool.map(_fetch, paths):
                pass


def _fetch(path: Path) -> None:
    with suppress(ObjectLost):
        local(path)


@contextmanager
def read_once(path: Path) -> Iterator[Path]:
    """Give what `local` gives, for the block only: what was not in the cache is not kept in it.

    A file that somebody has put there since it was stored is given instead of its object.

    Raises
    ------
    StorageError
        As `local`.
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
    """Return whether a file stands beside its pointer, and is another one than was stored."""
    try:
        found = path.stat()
    except OSError:
        return False
    return (found.st_size, found.st_mtime_ns) != (pointer.bytes, pointer.mtime_ns)


def pointer_of(path: Path) -> Pointer | None:
    """Return what is known of a file that is an object; None of any other."""
    return read_pointer(path) if in_use() else None


def named_by(path: Path) -> Path | None:
    """Return which file a file in a folder is, or stands for; None for hidden files that are no pointers."""
    if not path.name.startswith("."):
        return path
    return pointed_path(path) if path.suffix == SUFFIX and in_use() is not None else None


def is_there(path: Path) -> bool:
    """Return whether a file exists, without fetching it."""
    return path.is_file() or pointer_of(path) is not None


def facts_of(path: Path) -> tuple[int, int] | None:
    """Return when a file was changed, in nanoseconds, and its bytes, without fetching it; None: no file."""
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
    """Store a file's content before something names it, and keep a copy; None where there is no storage.

    Raises
    ------
    StorageUnavailable, DiskFull, StorageError
    """
    storage = in_use()
    if storage is None:
        return None
    pointer = storage.store(file)
    storage.cache.adopt(file, pointer, name=file.name)
    return pointer


def put_in_place(file: Path, target: Path, *, pointer: Pointer) -> None:
    """Let a pointer stand for a file whose content was stored by `store`, and delete that one.

    Nothing is copied here, as it may be done while others wait for their changes.

    Raises
    ------
    StorageError
        The disk refused: the file is still there.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    write_pointer(target, pointer)
    storage = in_use()
    if storage is not None:
        storage.cache.rename(pointer, before=file.name, name=target.name)
    discard(file)


def publish(path: Path) -> None:
    """Make an object of a file in the folder, if there is a storage and this is still to be done.

    Raises
    ------
    StorageUnavailable, DiskFull, StorageError
        The file is still there.
    """
    pointer = store(path) if path.is_file() else None
    if pointer is not None:
        put_in_place(path, path, pointer=pointer)


def settle(path: Path) -> None:
    """Make an object of a computed file that is complete, where the library that it lies in has a storage.

    Elsewhere it stays a file: nobody knows there which objects are needed.

    Raises
    ------
    StorageUnavailable, DiskFull, StorageError
        The file is still there.
    """
    if in_use() is not None and is_kept_in_objects(path):
        publish(path)


def bring_back(path: Path) -> None:
    """Make a file of an object again, and forget the object; a file that somebody has put there stays.

    Raises
    ------
    StorageUnavailable, ObjectLost, DiskFull, StorageError
        The pointer is still there.
    """
    pointer = read_pointer(path)
    if pointer is None:
        return
    if not path.is_file() or _is_same(path, pointer):
        # the same each time, so that one that was killed leaves nothing for good
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


def _check_unchanged(file: Path, before: os.stat_result) -> None:
    """Refuse a file that is not what it was.

    Raises
    ------
    StorageError
    """
    now = file.stat()
    if (now.st_size, now.st_mtime_ns, now.st_ino) != (before.st_size, before.st_mtime_ns, before.st_ino):
        raise StorageError(
            "this file was changed while it was being stored",
            where=str(file),
            hint="try again when it is complete",
        )


def _is_same(path: Path, pointer: Pointer) -> bool:
    """Return whether a file next to its pointer is what was stored, by size and time."""
    facts = path.stat()
    return (facts.st_size, facts.st_mtime_ns) == (pointer.bytes, pointer.mtime_ns)


def replaced(path: Path) -> None:
    """Let a file that was written just now count, and no longer the object that stood for it."""
    if in_use() is not None:
        discard(pointer_path(path))


def remove(path: Path) -> None:
    """Delete a file and its pointer; the object is swept when nothing has named it for long."""
    discard(path)
    if in_use() is not None:
        discard(pointer_path(path))
