"""Opens the object storage of a library, and checks that they belong together."""

from __future__ import annotations

import secrets
import tempfile
from pathlib import Path

from filelock import FileLock

from webapp.errors import ObjectLost, StorageError, UsageError
from webapp.files.atomic import write_text
from webapp.files.contents import connect
from webapp.files.object_storage.storage import MARKER, ObjectStorage, check_marker, read_marker
from webapp.files.part_file import discard
from webapp.settings import Settings
from webapp.store.library import Library

_OWNER = "library"
"""Object with the name of the library that the storage belongs to."""

_CLAIM = "object-storage-claim"
"""File in `.library` with the library's name for the storage, until it is written to the marker."""

_WAIT_S = 60.0


def refuse_objects(inner: Path, *, doing: str) -> None:
    """Refuse work that cannot access photos in the object storage, if there are any. Raises UsageError."""
    address = read_marker(inner)[0]
    if address is not None:
        raise UsageError(
            f"{doing} would lack the photos, which are in {address}",
            where=str(inner.parent),
            hint="run expmap library move --to folder first",
        )


def open_storage(library: Library, settings: Settings) -> None:
    """Use the object storage of a library in this process, if it has one.

    Raises:
        StorageError: The library has another storage than the settings name, or they name none.
        UsageError, MissingPart: See `connect`.
    """
    is_marked, marker = check_marker(library.inner, settings), library.inner / MARKER
    storage = connect(settings)
    if is_marked:
        discard(library.inner / _CLAIM)
    if storage is None or settings.storage is None or is_marked:
        return
    with FileLock(library.inner / "storage.lock", timeout=_WAIT_S):
        if not marker.is_file():
            owner = _own_name(library.inner)
            _claim(storage, owner)
            write_text(marker, f"{settings.storage}\n{owner}\n")
            discard(library.inner / _CLAIM)


def check_owner(inner: Path, storage: ObjectStorage) -> None:
    """Refuse an object storage that does not, or no longer, belong to the library with this inner folder.

    Raises StorageError.
    """
    owner = _owner(storage)
    if owner is None or owner != read_marker(inner)[1]:
        raise _not_ours(storage)


def _own_name(inner: Path) -> str:
    """Choose the library's name for the storage, and write it to disk before claiming the storage.

    If a process is killed after the claim, or gets no response, the next start recognises its own claim.
    """
    claim = inner / _CLAIM
    name = claim.read_text("utf-8").strip() if claim.is_file() else ""
    if not name:
        name = secrets.token_hex(16)
        write_text(claim, f"{name}\n")
    return name


def _claim(storage: ObjectStorage, owner: str) -> None:
    """Claim a storage that has no owner, or this one already."""
    found = _owner(storage)
    if found == owner:
        return
    if found is not None:
        raise _not_ours(storage)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, _OWNER)
        file.write_text(owner, "utf-8")
        storage.bucket.put(_OWNER, file)


def _owner(storage: ObjectStorage) -> str | None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, _OWNER)
        try:
            storage.bucket.get(_OWNER, file)
        except ObjectLost:
            return None
        return file.read_text("utf-8")


def _not_ours(storage: ObjectStorage) -> StorageError:
    return StorageError(
        "this object storage belongs to another library",
        where=storage.bucket.url,
        hint="give each library a prefix of its own: EXPMAP_STORAGE",
    )
