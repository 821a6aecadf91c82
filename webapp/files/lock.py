"""File locks between processes: one writer at a time for a map, and whether workers are alive."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from webapp.errors import StorageError


@contextmanager
def writer_lock(folder: Path, *, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the folder's lock; the system frees it when the process ends, however it ends.

    Parameters
    ----------
    folder : Path
        Is made when missing.
    wait_s : float
        Seconds to wait for another writer.

    Raises
    ------
    StorageError
        Another process is writing, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / "lock", timeout=wait_s)
        lock.acquire()
    except Timeout as error:
        raise StorageError(
            "another process is building this index", where=str(folder), hint="wait until it has finished"
        ) from error
    except OSError as error:
        raise StorageError(
            f"the folder cannot be written: {error.strerror}",
            where=str(folder),
            hint="choose a folder that you may write to with --index FOLDER",
        ) from error
    try:
        yield
    finally:
        lock.release()


def any_alive(folder: Path) -> bool:
    """Return whether one of the files in a folder is locked by a process of this machine.

    Parameters
    ----------
    folder : Path
        Of `*.lock` files; may be missing.
    """
    return any(_is_held(path) for path in folder.glob("*.lock"))


def _is_held(path: Path) -> bool:
    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
