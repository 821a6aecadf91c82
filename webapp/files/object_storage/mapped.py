"""Which files of a folder are mapped into memory, where the system says so."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_PROCESSES = Path("/proc")
_COLUMNS = 5
"""Of a line before the path, which may have blanks."""


def mapped_names(folder: Path) -> set[str]:
    """List the names of files below a folder that a process of this user has mapped.

    Returns
    -------
    set of str
        Without folders; empty where the system has no `/proc`, or shows nothing there.
    """
    inside, found = os.fsencode(f"{folder.resolve()}/"), set()
    for maps in _PROCESSES.glob("[0-9]*/maps"):
        with suppress(OSError):  # ended meanwhile, or somebody else's
            for line in maps.read_bytes().splitlines():
                path = line.split(maxsplit=_COLUMNS)[_COLUMNS:]
                if path and path[0].startswith(inside):
                    found.add(os.fsdecode(path[0].rpartition(b"/")[2]))
    return found
