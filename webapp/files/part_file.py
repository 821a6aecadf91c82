"""The part file of an upload: chunks are appended, and the complete file is moved to its place."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from filelock import FileLock, Timeout

from webapp.errors import Conflict, DiskFull, ExpMapError, InputError
from webapp.files.atomic import storage_error, sync_folder

_BLOCK = 1 << 20
_WAIT_S = 30


class WrongOffset(Conflict):
    """A chunk does not begin where the bytes received so far end.

    Attributes:
        offset: Bytes received so far: where to resume.
    """

    def __init__(self, message: str, *, offset: int) -> None:
        super().__init__(message, hint=f"resume at byte {offset}")
        self.offset = offset


@contextmanager
def one_at_a_time(part: Path) -> Iterator[None]:
    """Lock an upload, so that one process or thread at a time works on its bytes.

    Uploads whose names begin alike share a lock file; these are few and never deleted, which avoids races.
    """
    try:
        with FileLock(part.with_name(f"{part.name[:2]}.lock"), timeout=_WAIT_S):
            yield
    except Timeout as error:
        raise Conflict("this upload is busy", hint="try again in a moment") from error


def arrived(part: Path) -> int:
    """Count the bytes of an upload that are on the disk."""
    try:
        return part.stat().st_size
    except FileNotFoundError:
        return 0


def append(part: Path, data: bytes, *, offset: int, size: int) -> int:
    """Append a chunk; on return, it is on the disk.

    Args:
        part: Created with the first chunk.
        offset: Position of the chunk in the file, according to the sender.

    Raises:
        WrongOffset: The bytes received so far do not end at `offset`; nothing was changed.
        InputError: The chunk exceeds the size of the file.
        DiskFull, StorageError: Writing failed; the chunk was not kept.
    """
    there = arrived(part)
    if offset != there:
        raise WrongOffset(f"{there} bytes have arrived, but the chunk begins at {offset}", offset=there)
    if there + len(data) > size:
        raise InputError(
            f"the chunk goes beyond the {size} bytes of the file", hint="send the size of the file first"
        )
    with _on_disk(part):
        try:
            with part.open("ab") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            if part.exists():
                os.truncate(part, there)
            raise
    return there + len(data)


def receive(part: Path, stream: IO[bytes], *, max_bytes: int) -> int:
    """Write a stream to a new file; on return, it is on the disk.

    Args:
        part: Must not exist.

    Raises:
        InputError: There are more than `max_bytes`; nothing was kept.
        DiskFull, StorageError: Writing failed; nothing was kept.
    """
    written = 0
    try:
        with _on_disk(part), part.open("xb") as file:
            while block := stream.read(_BLOCK):
                written += len(block)
                if written > max_bytes:
                    raise InputError(f"the file has more than {max_bytes / 1e6:g} MB", hint="scale it down")
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
    except ExpMapError:
        discard(part)
        raise
    return written


def move_in(source: Path, target: Path) -> None:
    """Move a complete file to its place, durably even in a power cut.

    Args:
        source: On the same disk.
        target: Its folder is created if missing.

    Raises:
        DiskFull, StorageError: The file is still at `source`.
    """
    with _on_disk(target):
        with source.open("rb+") as file:
            os.fsync(file.fileno())
        if not target.parent.is_dir():
            target.parent.mkdir(parents=True, exist_ok=True)
            sync_folder(target.parent.parent)
        source.replace(target)
        sync_folder(target.parent)


def discard(part: Path) -> None:
    """Delete a part file, or any other file, if it exists."""
    part.unlink(missing_ok=True)


def check_space(folder: Path, size: int, *, reserve_mb: float) -> None:
    """Check that the disk has space for `size` bytes and the reserve. Raises DiskFull."""
    free = shutil.disk_usage(folder).free
    if free - size < reserve_mb * 1e6:
        raise DiskFull(
            f"{size / 1e6:.0f} MB are needed, and the disk has {free / 1e6:.0f} MB left, "
            f"of which {reserve_mb:g} MB are kept free",
            hint="free some space on the disk of the library",
        )


@contextmanager
def show_file_as(name: str, path: Path | None = None) -> Iterator[None]:
    """Replace a file's path on the server in errors by the name that its sender gave it.

    Args:
        path: Path on the server; None for bytes without a file.
    """
    try:
        yield
    except ExpMapError as error:
        here = name if path is None else str(path)
        error.message = error.message.replace(here, name)
        error.where = error.where.replace(here, name) if error.where else name
        raise


@contextmanager
def _on_disk(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise storage_error(error, where=path.name) from error


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
