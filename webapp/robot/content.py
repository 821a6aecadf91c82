"""What is in a spool, read while a robot may be writing to it."""

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
    """What is in a spool.

    Attributes
    ----------
    written : int
        Records since it was begun.
    waiting : int
        Of them, how many the server has not acknowledged.
    photos : int
        Photos that wait.
    size : int
        Bytes of records and photos.
    aside : list of dict
        What the server does not have and will not get: `first` and `count` of the records, `reason`, and
        maybe the `record`, or the path of the `photo` in the spool.
    """

    identity: Identity
    written: int
    waiting: int
    photos: int
    size: int
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
    """Read what is in a spool, also while a robot writes to it.

    Raises
    ------
    UsageError
        There is none.
    StorageError
        It is damaged.
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
