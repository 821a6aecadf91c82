"""The file of a library that names the object storage of its photos; found from the path of a map."""

from __future__ import annotations

from dataclasses import replace
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


def is_kept_in_objects(path: Path) -> bool:
    """Return whether a path is in a library with a storage; elsewhere, no objects are named or swept."""
    return _inner(path) is not None


def settings_at(path: Path, settings: Settings) -> Settings:
    """Return the settings for a map, whose storage is that of its library, or none.

    Raises:
        StorageError: The library has a storage other than the settings'.
    """
    inner = _inner(path)
    if inner is None:
        return settings if settings.storage is None else replace(settings, storage=None)
    check_marker(inner, settings)
    return settings


def _inner(path: Path) -> Path | None:
    for folder in path.absolute().parents:
        if (folder / _INNER / MARKER).is_file():
            return folder / _INNER
    resolved = path.resolve()
    return None if resolved == path.absolute() else _inner(resolved)
