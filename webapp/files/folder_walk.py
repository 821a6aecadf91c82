"""All files of a folder, in the order a person would list them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from webapp.errors import UsageError

_DIGITS = re.compile(r"([0-9]+)")

Key = tuple[tuple[tuple[int, int, str], ...], ...]


def list_files(folder: Path, *, leave_out: Iterable[Path] = ()) -> list[str]:
    """List the files below a folder, relative to it with forward slashes, in natural order (2 before 10).

    Names that begin with a dot are left out; links to folders are not followed.

    Parameters
    ----------
    leave_out : iterable of Path
        Folders not to enter.

    Raises
    ------
    UsageError
        The folder, or one below it, cannot be listed.
    """
    closed = {path.resolve() for path in leave_out}
    found = []
    for parent, folders, files in os.walk(folder, onerror=_refuse):
        here = Path(parent)
        folders[:] = [f for f in folders if not f.startswith(".") and (here / f).resolve() not in closed]
        found += [(here / f).relative_to(folder).as_posix() for f in files if not f.startswith(".")]
    return sorted(found, key=natural_key)


def natural_key(name: str) -> tuple[Key, str]:
    """Give the sort key of a path: folder by folder, numbers by value, letter case last."""
    parts = tuple(
        tuple(
            (0, int(piece), "") if piece.isascii() and piece.isdigit() else (1, 0, piece)
            for piece in _DIGITS.split(part)
            if piece
        )
        for part in name.casefold().split("/")
    )
    return parts, name


def _refuse(error: OSError) -> None:
    message = f"the folder cannot be listed: {error.strerror or error}"
    raise UsageError(message, where=str(error.filename), hint="check its path and permissions") from error
