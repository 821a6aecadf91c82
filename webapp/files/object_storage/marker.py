"""The file of a library that names the object storage of its photos; found from the path of a map."""

from __future__ import annotations

from pathlib import Path

from webapp.errors import StorageError
from webapp.settings import Settings

MARKER = "object-storage"
"""File in `.library`: the address of the storage, and the library's name in the storage."""

_INNER = ".library"  # as in `webapp.store.library`, which map commands do not load


def read_marker(inner: Path) -> tuple[str | None, str | None]:
    """Read the address of a library's storage, and the library's name in it; None where missing.

    Args:
        inner: The library's folder for all that is not a map.
    """
    marker = inner / MARKER
    lines = marker.read_text("utf-8").split() if marker.is_file() else []
    address, owner = [*lines, None, None][:2]
    return address, owner


def check_marker(inner: Path, settings: Settings) -> bool:
    """Return whether a library has a storage, and check that it is the one of the settings.

    Raises:
        StorageError: It is another one, or the settings name none.
    """
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
