"""Reads whole files, and writes them atomically, even if the machine crashes."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterable
from pathlib import Path

from webapp.errors import DiskFull, DiskReadOnly, StorageError

_HINTS = {
    errno.ENOSPC: "free some space on the disk",
    errno.EDQUOT: "free some space: the quota is used up",
    errno.EACCES: "choose a folder that you may write to, or change its permissions",
    errno.EPERM: "choose a folder that you may write to, or change its permissions",
    errno.EROFS: "the disk is read-only: choose another folder",
    errno.ENOENT: "create the folder first",
    errno.ENOTDIR: "create the folder first",
    errno.EISDIR: "a folder has this name: choose another one",
    errno.ENAMETOOLONG: "choose a shorter name",
}

_KINDS = {errno.ENOSPC: DiskFull, errno.EDQUOT: DiskFull, errno.EROFS: DiskReadOnly}


def make_folder(folder: Path) -> None:
    """Create a folder and its missing parents. Raises StorageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(error, where=folder.name) from error


def read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise StorageError(f"cannot be read: {error.strerror}", where=str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text like `write_bytes`; line ends are not converted."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, *parts: bytes | memoryview) -> None:
    """Replace a file like `write_pieces`, by parts that need not be joined in memory."""
    write_pieces(path, parts)


def write_pieces(path: Path, pieces: Iterable[bytes | memoryview]) -> None:
    """Replace a file atomically: afterwards it holds all of the old content or all of the new.

    The data is written to a temporary file in the same folder and synced, and the file is renamed. The
    permissions of an existing file are kept; a symbolic link is replaced, not followed.
    """
    temporary = path.with_name(f".{path.name[:80]}.{secrets.token_hex(6)}.tmp")
    try:
        try:
            _write_through(temporary, pieces)
            if path.is_file() and not path.is_symlink():
                temporary.chmod(stat.S_IMODE(path.stat().st_mode))
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        sync_folder(path.parent)
    except OSError as error:
        raise storage_error(error, where=str(path)) from error


def remove_unfinished(path: Path) -> None:
    """Remove temporary files of killed writers; the caller must hold the lock of the file's writers."""
    for temporary in path.parent.glob(f".{path.name[:80]}.*.tmp"):
        temporary.unlink(missing_ok=True)


def takes_nothing(error: OSError) -> bool:
    """Return whether the disk, or the user's quota, is full, or the disk read-only."""
    return error.errno in _KINDS


def storage_error(error: OSError, *, where: str) -> StorageError:
    """Convert an OSError from writing a file to a `StorageError`, which is returned, not raised."""
    kind = _KINDS.get(error.errno or 0, StorageError)
    reason = error.strerror or str(error)
    return kind(f"the file cannot be written: {reason}", where=where, hint=_HINTS.get(error.errno or 0))


def _write_through(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    with path.open("xb") as file:
        file.writelines(parts)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Sync a folder, so that a new name in it is durable; not on Windows and some network file systems."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)
