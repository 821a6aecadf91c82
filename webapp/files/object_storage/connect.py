"""Opens the object storage of the settings, once per process."""

from __future__ import annotations

import hashlib
import threading
from pathlib import Path

from platformdirs import user_cache_path

from webapp.errors import UsageError
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import ObjectCache
from webapp.files.object_storage.storage import ObjectStorage, in_use, use
from webapp.settings import Settings

_LOCK = threading.Lock()


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
    """Return the folder of this machine's cache."""
    name = hashlib.sha256((settings.storage or "").encode()).hexdigest()[:16]
    return settings.cache_folder or user_cache_path("experience-map") / "objects" / name
