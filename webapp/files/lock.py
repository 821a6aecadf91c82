"""File locks between processes: one writer at a time for a map, and a check that workers are alive."""

from __future__ import annotations

import errno
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.errors import Busy, FolderInUse, StorageError

_AGAIN_S = 10
"""Seconds until a retry: a file server frees the locks of a lost machine only after a minute or two."""


def allow_open_files(count: int) -> None:
    """Raise the process's limit of open files as far as the system allows: each held lock is an open file."""
    if sys.platform == "win32":
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = count if hard == resource.RLIM_INFINITY else min(count, hard)
    if resource.RLIM_INFINITY != soft < wanted:
        with suppress(ValueError, OSError):  # some systems allow less than the limit they report
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


@contextmanager
def writer_lock(folder: Path, *, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the folder's lock; the system frees it when the process ends, however it ends.

    Args:
        folder: Created if missing.
        wait_s: Seconds to wait for another writer.

    Raises:
        FolderInUse: Another process is writing.
        StorageError: The folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / "lock", timeout=wait_s)
        lock.acquire()
    except Timeout as error:
        raise FolderInUse(
            "another process is building this index",
            where=str(folder),
            wait_s=_AGAIN_S,
            hint="wait until it has finished",
        ) from error
    except OSError as error:
        raise StorageError(
            f"the folder cannot be written: {error.strerror}",
            where=str(folder),
            hint="choose a writable folder with --index FOLDER",
        ) from error
    try:
        yield
    finally:
        lock.release()


def exclusive(path: Path, *, doing: str, wait_s: int = 60) -> AbstractContextManager[None]:
    """Run the block in one process at a time; fail at once if another holds the lock.

    Args:
        path: The lock file; its folder is created if missing.
        doing: Message of `Busy`: what the other process is doing.
        wait_s: Seconds after which `Busy` suggests to try again.
    """
    return one_of([path], doing=doing, wait_s=wait_s)


@contextmanager
def one_of(paths: Sequence[Path], *, doing: str, wait_s: int) -> Iterator[None]:
    """Hold one of several locks, so that the block runs in as many processes or threads at a time.

    Parameters and errors as for `exclusive`.
    """
    held = None
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock = FileLock(path, timeout=0)
            with suppress(Timeout):
                lock.acquire()
                held = lock
                break
    except OSError as error:
        raise StorageError(
            f"the folder cannot be written: {error.strerror}", where=str(paths[0].parent)
        ) from error
    if held is None:
        raise Busy(doing, wait_s=wait_s, hint="wait until it has finished")
    try:
        yield
    finally:
        held.release()


@contextmanager
def rate_limited(path: Path, *, gap_s: float, wait_s: float) -> Iterator[None]:
    """Run the block in one process at a time, with a minimum gap between runs.

    Args:
        path: The lock file; its folder is created if missing.
        gap_s: Minimum seconds from the end of one run to the start of the next.
        wait_s: Seconds to wait for the lock.

    Raises:
        Busy: The lock was not free within `wait_s`.
        StorageError: The folder cannot be written.
    """
    ended = path.with_name(f"{path.name}.ended")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=wait_s)
        lock.acquire()
    except Timeout as error:
        raise Busy(
            "the server is busy with other requests", wait_s=math.ceil(wait_s), hint="try again in a moment"
        ) from error
    except OSError as error:
        raise StorageError(
            f"the folder cannot be written: {error.strerror}", where=str(path.parent)
        ) from error
    try:
        since_s = time.time() - ended.stat().st_mtime if ended.exists() else gap_s
        if since_s < gap_s:
            time.sleep(min(gap_s - since_s, gap_s))  # at most the gap, even if the clock was set back
        yield
    finally:
        ended.touch()
        lock.release()


def any_alive(folder: Path, *, but: str = "") -> bool:
    """Return whether a process has locked one of the files in a folder.

    If several machines share the disk and its locks, the process may be on any of them.

    Args:
        folder: Contains `*.lock` files; may be missing.
    """
    return any(_is_held(path) for path in folder.glob("*.lock") if not path.match(but or "-"))


def _is_held(path: Path) -> bool:
    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
    except OSError as error:
        if error.errno != errno.EROFS:
            raise
        return _is_held_unwritable(path)


def _is_held_unwritable(path: Path) -> bool:
    """Check a lock on a read-only disk, where `FileLock` cannot open its file."""
    if sys.platform == "win32":
        return True
    import fcntl

    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
