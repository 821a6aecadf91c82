"""What the disk does for a spool: bytes that stay, errors in words, one owner of a folder."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from webapp.errors import Conflict, DiskFull, StorageError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Turn what the system says about a file into an error of ours.

    Raises
    ------
    DiskFull, StorageError
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if is_full(error):
            raise DiskFull(
                f"the disk is full: {reason}",
                where=str(path),
                hint="free some space on the disk of the spool",
            ) from error
        raise StorageError(
            f"the file cannot be used: {reason}",
            where=str(path),
            hint="choose a folder that you may write to",
        ) from error


def is_full(error: OSError) -> bool:
    """Tell whether the disk, or the share of it that one may use, is full."""
    return error.errno in _FULL


def write_whole(path: Path, *parts: bytes) -> None:
    """Replace a file: afterwards, also after a power cut, it holds all of the old or all of the new."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.writelines(parts)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make sure that the names in a folder survive a power cut; on Windows they do by themselves."""
    if sys.platform != "win32":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class FolderLock:
    """One process, and in it one owner, at a time; the system lets go of it when the process ends.

    Parameters
    ----------
    folder : Path
        Exists.

    Raises
    ------
    Conflict
        Somebody else has it.
    """

    def __init__(self, folder: Path) -> None:
        self._file = (folder / "lock").open("a+b")
        try:
            _lock(self._file.fileno())
        except OSError as error:
            self._file.close()
            raise Conflict(
                "another program is using this spool", where=str(folder), hint="wait until it has ended"
            ) from error

    def release(self) -> None:
        """Let others have the folder."""
        self._file.close()


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
