"""Lists the files of a folder, and finds files whose names in a map are misspelt."""

from __future__ import annotations

import difflib
import os
import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from webapp.errors import UsageError
from webapp.files.contents import shown_name
from webapp.files.decode import PHOTO_SUFFIXES

_DIGITS = re.compile(r"([0-9]+)")

Key = tuple[tuple[tuple[int, int, str], ...], ...]

_MOST_COMPARISONS = 8_000_000
"""Limit of pairs of characters compared, about a second; with more, typing errors are not the cause."""

DERIVED = "derived"
"""Folder next to a map for what is computed from it."""


def list_photos(folder: Path) -> list[str]:
    """List the photos below a folder, sorted, relative to it with forward slashes.

    Hidden files and folders and `derived` are left out; links to folders are not followed.
    """
    found = []
    for parent, folders, files in os.walk(folder):
        here = Path(parent)
        folders[:] = [f for f in folders if not f.startswith(".") and (here != folder or f != DERIVED)]
        for name in map(shown_name, files):
            if Path(name).suffix.lower() in PHOTO_SUFFIXES and not name.startswith("."):
                found.append((here / name).relative_to(folder).as_posix())
    return sorted(set(found))


def normal_name(name: str) -> str:
    """Normalise a relative path: drop `./` and doubled slashes."""
    return PurePosixPath(name).as_posix()


class Spelling:
    """Finds files whose names differ from a given one in letter case, Unicode form, folder or by a typo."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = set(names)
        self._folded: dict[str, str] = {}
        self._last: dict[str, list[str]] = {}
        self._numbers: dict[tuple[str, str], list[str]] = {}
        self._comparisons_left = _MOST_COMPARISONS
        for name in sorted(self._names):
            self._folded.setdefault(folded(name), name)
            self._last.setdefault(_last(name), []).append(name)
            self._numbers.setdefault(_numbers(name), []).append(name)

    def same(self, name: str) -> str | None:
        """Find the file whose name differs only in letter case or Unicode form."""
        return None if name in self._names else self._folded.get(folded(name))

    def similar(self, name: str) -> str | None:
        """Find the file probably meant: the same name in another folder, or a similar one in this folder."""
        elsewhere = self._last.get(_last(name), [])
        if len(elsewhere) == 1:
            return elsewhere[0]
        # names that differ in a digit are other photos, not typing errors
        siblings = self._numbers.get(_numbers(name), [])
        if self._comparisons_left >= 0:
            self._comparisons_left -= len(name) * sum(map(len, siblings))
        if self._comparisons_left < 0:
            return None
        return next(iter(difflib.get_close_matches(name, siblings, n=1, cutoff=0.8)), None)


def folded(name: str) -> str:
    """Return a name in NFC and case-folded, to compare names that some file systems take as equal."""
    return unicodedata.normalize("NFC", name).casefold()


def _last(name: str) -> str:
    return folded(PurePosixPath(name).name)


def list_files(folder: Path, *, leave_out: Iterable[Path] = ()) -> list[str]:
    """List the files below a folder, relative to it with forward slashes, in natural order (2 before 10).

    Names that begin with a dot are left out; links to folders are not followed.
    """
    closed = {path.resolve() for path in leave_out}
    found = []
    for parent, folders, files in os.walk(folder, onerror=_refuse):
        here = Path(parent)
        folders[:] = [f for f in folders if not f.startswith(".") and (here / f).resolve() not in closed]
        found += [(here / f).relative_to(folder).as_posix() for f in files if not f.startswith(".")]
    return sorted(found, key=natural_key)


def _refuse(error: OSError) -> None:
    message = f"the folder cannot be listed: {error.strerror or error}"
    raise UsageError(message, where=str(error.filename), hint="check its path and permissions") from error


def natural_key(name: str) -> tuple[Key, str]:
    """Return the sort key of a path: folder by folder, numbers by value, letter case last."""
    parts = tuple(
        tuple(
            (0, int(piece), "") if piece.isascii() and piece.isdigit() else (1, 0, piece)
            for piece in _DIGITS.split(part)
            if piece
        )
        for part in name.casefold().split("/")
    )
    return parts, name


def _numbers(name: str) -> tuple[str, str]:
    """Return the folder of a file and the digits in its name."""
    path = PurePosixPath(name)
    return folded(str(path.parent)), "".join(letter for letter in path.name if letter.isdigit())
