"""Identity of a spool, and the tables of its database."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .database import SpoolDatabase
from .errors import UsageError

_FORMAT = 2

IDENTITY = "SELECT id, mission, url, about FROM spool"

_SCHEMA = (
    "CREATE TABLE spool (one INTEGER PRIMARY KEY CHECK (one = 1), id TEXT, mission INTEGER,"
    " url TEXT, about TEXT, made TEXT, next INTEGER DEFAULT 0, wire INTEGER DEFAULT 0,"
    " sent INTEGER DEFAULT 0)",
    "CREATE TABLE records (number INTEGER PRIMARY KEY, crc INTEGER, text TEXT)",
    "CREATE TABLE aside (id INTEGER PRIMARY KEY, first INTEGER, stop INTEGER, reason TEXT,"
    " photo TEXT, record TEXT)",
    "CREATE INDEX aside_by_stop ON aside (stop)",
    "CREATE TABLE photos (id INTEGER PRIMARY KEY AUTOINCREMENT, file TEXT, name TEXT, sha256 TEXT,"
    " size INTEGER, time REAL, object TEXT)",
    f"PRAGMA user_version = {_FORMAT}",
)


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of a spool."""

    id: str  # Identifies the sender to the server
    mission: int
    url: str  # Address of the server
    about: str  # Source of the data; a spool with a different `about` is refused


def create_tables(database: SpoolDatabase) -> None:
    """Create the tables of a spool if they are missing.

    Raises:
        UsageError: The spool was written by a newer version.
    """
    version = database.select("PRAGMA user_version")[0][0]
    if version > _FORMAT:
        raise UsageError(
            "the spool was written by a newer version", where=str(database.folder), hint="update this program"
        )
    if version < _FORMAT:
        database.write(*((statement, ()) for statement in _SCHEMA), durable=True)


def check_version(folder: Path) -> None:
    """Check that a folder does not hold a spool of version 0.7.0, which had another format.

    Raises UsageError.
    """
    if (folder / "spool.json").exists():
        raise UsageError(
            "the spool was written by the released version 0.7.0, which kept it in other files",
            where=str(folder),
            hint="upload it with that version: expmap robot recover SPOOL; then choose another folder",
        )
