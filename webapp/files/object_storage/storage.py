"""Objects in a bucket, with a local cache."""

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
from webapp.files.object_storage.cache import ObjectCache
from webapp.files.object_storage.pointer import Pointer
from webapp.files.part_file import sha256_of

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
            StorageUnavailable, DiskFull
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
    """Refuse a file that has changed."""
    now = file.stat()
    if (now.st_size, now.st_mtime_ns, now.st_ino) != (before.st_size, before.st_mtime_ns, before.st_ino):
        raise StorageError(
            "this file was changed while it was being stored",
            where=str(file),
            hint="try again when it is complete",
        )
