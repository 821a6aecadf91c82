"""Reads the content of a spool, also while a robot is writing to it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .database import FILE, DatabaseDamaged, open_for_reading, read
from .errors import UsageError
from .schema import IDENTITY, Identity, check_version


@dataclass(frozen=True, slots=True)
class SpoolContent:
    """The content of a spool."""

    identity: Identity
    written: int  # Number of records since the spool was created
    waiting: int  # Number of records that the server has not acknowledged
    photos: int  # Number of photos waiting
    size: int  # Bytes of records and photos
    # Data that will never be sent: `first` and `count` of the records, `reason`, and optionally the `record`,
    # or the path of the `photo` in the spool.
    aside: list[dict[str, Any]]


def has_spool(folder: Path) -> bool:
    """Check whether there is a spool in a folder."""
    check_version(folder)
    if not (folder / "data" / FILE).exists():
        return False
    connection = open_for_reading(folder / "data")
    try:
        return bool(read(connection, IDENTITY))
    except DatabaseDamaged:
        return True
    finally:
        connection.close()


def read_content(folder: Path) -> SpoolContent:
    """Read the content of a spool, also while a robot writes to it.

    Raises:
        UsageError: The folder holds no spool.
        StorageError: The spool is damaged.
    """
    if not has_spool(folder):
        raise UsageError(
            "there is no spool in this folder", where=str(folder), hint="name the folder of a spool"
        )
    connection = open_for_reading(folder / "data")
    try:
        connection.execute("BEGIN")
        identity = Identity(*read(connection, IDENTITY)[0])
        ((next_, sent),) = read(connection, "SELECT next, sent FROM spool")
        ((last,),) = read(connection, "SELECT max(number) FROM records")
        ((photos, photo_bytes),) = read(connection, "SELECT count(*), coalesce(sum(size), 0) FROM photos")
        pages = [read(connection, f"PRAGMA {n}")[0][0] for n in ("page_count", "freelist_count", "page_size")]
        rows = read(connection, "SELECT first, stop, reason, photo, record FROM aside ORDER BY id")
    finally:
        connection.close()
    written = max(sent, -1 if last is None else last + 1)
    size = (pages[0] - pages[1]) * pages[2] + photo_bytes
    return SpoolContent(identity, written, written - next_, photos, size, [_aside(row) for row in rows])


def _aside(row: tuple[Any, ...]) -> dict[str, Any]:
    first, stop, reason, photo, record = row
    entry: dict[str, Any] = {"first": first, "count": stop - first, "reason": reason}
    if photo is not None:
        entry["photo"] = f"data/photos/{photo}"
    if record is not None:
        entry["record"] = json.loads(record)
    return entry
