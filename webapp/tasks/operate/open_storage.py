"""The object storage of a library: which one it is, and that nobody goes without it."""

from __future__ import annotations

from pathlib import Path

from webapp.errors import StorageError, UsageError
from webapp.files.atomic import write_text
from webapp.files.objects.connect import connect
from webapp.settings import Settings
from webapp.store.library import Library

MARKER = "object-storage"
"""File of the library with the address of its storage."""


def refuse_objects(inner: Path, *, doing: str) -> None:
    """Refuse work that would not find photos which are objects.

    Parameters
    ----------
    inner : Path
        The library's folder of everything that is not a map.

    Raises
    ------
    UsageError
    """
    marker = inner / MARKER
    if marker.is_file():
        raise UsageError(
            f"{doing} would lack the photos, which are in {marker.read_text('utf-8').strip()}",
            where=str(inner.parent),
            hint="see Backup in docs/cluster.md",
        )


def open_storage(library: Library, settings: Settings) -> None:
    """Use the object storage of a library in this process, if it has one.

    Raises
    ------
    StorageError
        The library has another one, or has one and the settings name none.
    UsageError, MissingPart
        As for `connect`.
    """
    marker = library.inner / MARKER
    before = marker.read_text("utf-8").strip() if marker.is_file() else None
    if before is not None and before != settings.storage:
        raise StorageError(
            "the photos of this library are in an object storage",
            where=str(library.folder),
            hint=f"set EXPMAP_STORAGE: {before}",
        )
    if connect(settings) is not None and settings.storage is not None and before is None:
        write_text(marker, f"{settings.storage}\n")
