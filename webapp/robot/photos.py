"""Photos waiting to be sent: files next to the database, which has a row for each.

A file without a row is deleted at the next start: storing it was interrupted, or the server has it.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from .database import SpoolDatabase, storage_errors

_BLOCK = 1 << 16
_ROWS = "SELECT id, file, name, sha256, size, time, object FROM photos ORDER BY id"


@dataclass(frozen=True, slots=True)
class WaitingPhoto:
    """A photo on the disk of the robot."""

    id: int
    path: Path
    name: str  # File name, for display
    sha256: str  # Hexadecimal
    size: int  # Bytes
    time: float  # Seconds since 1970, UTC
    object: str | None  # The object that it shows


class PhotoQueue:
    """Queue of photos, oldest first.

    Args:
        database: The photos are stored in `photos/` next to it.
    """

    def __init__(self, database: SpoolDatabase) -> None:
        self._database = database
        self._folder = database.folder / "photos"
        with storage_errors(self._folder):
            self._folder.mkdir(exist_ok=True)
            self._delete_unknown()
        self.damaged = [photo for photo in self._waiting() if not _is_whole(photo)]
        """Photos whose file is missing or truncated."""
        sizes = [photo.size for photo in self._waiting()]
        self.count, self.size = len(sizes), sum(sizes)
        """Number of waiting photos, and their total bytes."""

    def add(self, source: BinaryIO, *, name: str, time: float, object_id: str | None) -> str:
        """Store a photo; when this returns, it survives a power cut.

        Returns:
            SHA-256, hexadecimal.

        Raises:
            DiskFull, StorageError: The photo was not stored.
        """
        self._database.require_reserve()
        plain = re.sub(r"[^\w.-]", "_", Path(name).name)[-60:]
        path = self._folder / f"{secrets.token_hex(4)}-{plain}"
        try:
            with storage_errors(path):
                sha256, size = _copy(source, path)
            self._database.write(
                (
                    "INSERT INTO photos (file, name, sha256, size, time, object) VALUES (?, ?, ?, ?, ?, ?)",
                    (path.name, name, sha256, size, time, object_id),
                ),
                durable=True,
            )
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self.count, self.size = self.count + 1, self.size + size
        return sha256

    def first(self) -> WaitingPhoto | None:
        """Return the photo that has waited longest."""
        return next(iter(self._waiting(limit=1)), None)

    def remove(self, photo: WaitingPhoto) -> None:
        """Delete a photo that the server has."""
        self._database.write(("DELETE FROM photos WHERE id = ?", (photo.id,)), urgent=True)
        self.count, self.size = self.count - 1, self.size - photo.size
        with storage_errors(photo.path):
            photo.path.unlink(missing_ok=True)

    def set_aside(self, photo: WaitingPhoto, *, reason: str, next_number: int) -> None:
        """Keep a photo that will not be sent, with the reason and the number of the next record."""
        self._database.write(
            ("DELETE FROM photos WHERE id = ?", (photo.id,)),
            (
                "INSERT INTO aside (first, stop, reason, photo) VALUES (?, ?, ?, ?)",
                (next_number, next_number, reason, photo.path.name),
            ),
            durable=True,
            urgent=True,
        )
        self.count, self.size = self.count - 1, self.size - photo.size

    def _waiting(self, *, limit: int = -1) -> list[WaitingPhoto]:
        rows = self._database.select(f"{_ROWS} LIMIT ?", limit)
        return [WaitingPhoto(id_, self._folder / file, *rest) for id_, file, *rest in rows]

    def _delete_unknown(self) -> None:
        rows = self._database.select("SELECT file FROM photos UNION SELECT photo FROM aside")
        known = {file for (file,) in rows}
        for path in self._folder.iterdir():
            if path.name not in known:
                path.unlink()


def _is_whole(photo: WaitingPhoto) -> bool:
    return photo.path.exists() and photo.path.stat().st_size == photo.size


def _copy(source: BinaryIO, target: Path) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    with target.open("xb") as file:
        while block := source.read(_BLOCK):
            digest.update(block)
            size += len(block)
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
    if sys.platform != "win32":  # Windows needs no sync of the folder
        descriptor = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    return digest.hexdigest(), size
