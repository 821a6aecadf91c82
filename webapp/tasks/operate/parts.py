"""What a library keeps besides its maps, as backup and restore handle it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol

from webapp.store.library import Library
from webapp.store.operate.snapshot import PartContents, Reader


class LibraryPart(Protocol):
    """Files of one kind of record, in `FOLDER/ID/...` of the library and `NAME/ID/...` of a backup."""

    @property
    def name(self) -> str:
        """First part of its files' names in a backup."""

    @property
    def folder(self) -> str:
        """Folder of the library, relative to it."""

    def contents(self, database: sqlite3.Connection) -> PartContents:
        """Read which records there are, and which files they need."""

    def locks(self, library: Library) -> Iterable[tuple[Path, str]]:
        """Name the lock files of writers that replace files, each with what it protects."""

    def replaced(self, library: Library, id: int) -> Iterable[Path]:
        """Name the files of a record that change under their names; they need not exist."""


def readers(parts: Iterable[LibraryPart]) -> Mapping[str, Reader]:
    """Give what reads each part's contents from a copy of the database."""
    return {part.name: part.contents for part in parts}
