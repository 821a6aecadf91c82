"""Folders of the library in which a map is put together before it gets its place."""

from __future__ import annotations

import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path

from webapp.store.library import Library

_STALE_S = 7 * 86_400
"""Nobody comes back to what is older."""


def make(library: Library) -> Path:
    """Make an empty folder; what was left behind there by killed processes is deleted."""
    there = parent(library)
    for old in there.iterdir():
        with suppress(FileNotFoundError):  # another import has just finished
            if time.time() - old.stat().st_mtime > _STALE_S:
                shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink(missing_ok=True)
    folder = there / secrets.token_hex(8)
    folder.mkdir()
    return folder


def parent(library: Library) -> Path:
    """Return the folder that they are in, on the disk of the maps; it is made when missing."""
    folder = library.inner / "imports"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
