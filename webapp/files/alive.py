"""Tells whether processes live that hold a locked file, each its own, as long as they do."""

from __future__ import annotations

from pathlib import Path

from filelock import FileLock, Timeout


def any_alive(folder: Path) -> bool:
    """Tell whether one of the files in a folder is locked by a process of this machine.

    Parameters
    ----------
    folder : Path
        Of `*.lock` files; may be missing.
    """
    return any(_is_held(path) for path in folder.glob("*.lock"))


def _is_held(path: Path) -> bool:
    try:
        with FileLock(path, timeout=0):
            return False
    except Timeout:
        return True
