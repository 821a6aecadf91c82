"""Objects in a bucket, with a local cache; the file of a library that names its storage."""

from __future__ import annotations

import logging
import math
import os
import secrets
import threading
import time
from pathlib import Path

from webapp.errors import ObjectLost, StorageError, StorageUnavailable
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import ObjectCache, Pointer
from webapp.files.part_file import sha256_of
from webapp.settings import Settings

_log = logging.getLogger(__name__)

_PROBE_S = 5.0


class ObjectStorage:
    """Objects in a bucket, and a local cache of them."""

    def __init__(self, bucket: Bucket, cache: ObjectCache) -> None:
        self.bucket = bucket
        self.cache = cache
        self._answers, self._probed_at, self._probing = True, -math.inf, threading.Lock()

    def store(self, file: Path) -> Pointer:
        """Store the content of a file under a new, unique key, to which nothing refers yet.

        Raises:
            StorageError: The disk failed, or the file changed meanwhile; nothing refers to an object stored
                anyway.
        """
        facts = file.stat()
        sha256 = sha256_of(file)
        pointer = Pointer(
            # Not the hash alone: the sweep of an orphan must not delete a new upload of the same content.
            f"{sha256[:2]}/{sha256}-{secrets.token_hex(8)}",
            sha256,
            facts.st_size,
            facts.st_mtime_ns,
        )
        try:
            self.bucket.put(pointer.key, file)
        except StorageUnavailable:
            _check_unchanged(file, facts)  # a change explains a mismatch of the checksum
            raise
        _check_unchanged(file, facts)
        return pointer

    def reachable(self) -> bool:
        """Return whether the server responds and grants access; probe it at most every `_PROBE_S` seconds."""
        with self._probing:
            if time.monotonic() >= self._probed_at + _PROBE_S:
                try:
                    self.bucket.probe()
                    self._answers = True
                except StorageError:  # already logged
                    self._answers = False
                self._probed_at = time.monotonic()
            return self._answers

    def fetch(self, path: Path, pointer: Pointer) -> Path:
        """Return a local copy of an object; errors are those of `ObjectCache.path` and `Bucket.get`."""
        try:
            return self.cache.path(
                pointer, name=path.name, fetch=lambda target: self.bucket.get(pointer.key, target)
            )
        except ObjectLost as error:
            _log.warning("%s: %s", path, error.message)
            raise


def _check_unchanged(file: Path, before: os.stat_result) -> None:
    now = file.stat()
    if (now.st_size, now.st_mtime_ns, now.st_ino) != (before.st_size, before.st_mtime_ns, before.st_ino):
        raise StorageError(
            "this file was changed while it was being stored",
            where=str(file),
            hint="try again when it is complete",
        )


MARKER = "object-storage"
"""File in `.library`: the address of the storage, and the library's name in the storage."""

_INNER = ".library"  # as in `webapp.store.library`, which map commands do not load


def read_marker(inner: Path) -> tuple[str | None, str | None]:
    """Read the address of a library's storage, and the library's name in it; None where missing."""
    marker = inner / MARKER
    lines = marker.read_text("utf-8").split() if marker.is_file() else []
    address, owner = [*lines, None, None][:2]
    return address, owner


def check_marker(inner: Path, settings: Settings) -> bool:
    """Return whether a library has a storage, and check that it is the one of the settings."""
    address = read_marker(inner)[0]
    if address is not None and address != settings.storage:
        raise StorageError(
            "the photos of this library are in an object storage",
            where=str(inner.parent),
            hint=f"set EXPMAP_STORAGE: {address}",
        )
    return address is not None


def library_with_objects(path: Path) -> Path | None:
    """Return the folder `.library` of the library with a storage that a path is in; None elsewhere."""
    for folder in path.absolute().parents:
        if (folder / _INNER / MARKER).is_file():
            return folder / _INNER
    resolved = path.resolve()
    return None if resolved == path.absolute() else library_with_objects(resolved)
