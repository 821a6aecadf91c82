"""Staging folders of the library, in which a map is prepared before it is moved to its place."""

from __future__ import annotations

import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path

from webapp.store.library import Library

_STALE_S = 7 * 86_400
"""Age from which on staging folders are deleted as abandoned."""


def make(library: Library) -> Path:
    """Make an empty staging folder; old ones left by killed processes are deleted."""
    there = parent(library)
    for old in there.iterdir():
        with suppress(FileNotFoundError):  # another import has just finished
            if time.time() - old.stat().st_mtime > _STALE_S:
                shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink(missing_ok=True)
    folder = there / secrets.token_hex(8)
    folder.mkdir()
    return folder


def parent(library: Library) -> Path:
    """Return the parent of the staging folders, on the file system of the maps; created if missing."""
    folder = library.inner / "imports"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
