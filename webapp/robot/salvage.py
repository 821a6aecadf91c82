"""Sets a damaged database aside, and recovers its readable rows.

Each step is one rename, so that the next start completes an interrupted recovery: a spool with a folder
`damaged-N` and no `data` has been set aside but not yet salvaged.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .database import SpoolDatabase, open_for_reading, storage_errors
from .schema import create_tables

_ROWS_AT_ONCE = 500
_TABLES = {
    "spool": ("one", "id", "mission", "url", "about", "made", "next", "wire", "sent"),
    "records": ("number", "crc", "CAST(text AS BLOB)"),
    "aside": ("id", "first", "stop", "reason", "photo", "record"),
    "photos": ("id", "file", "name", "sha256", "size", "time", "object"),
}
"""Columns of each table, the key first."""


def quarantine(folder: Path) -> None:
    """Rename `data` in the folder of a spool to `damaged-N`."""
    with storage_errors(folder):
        (folder / "data").rename(folder / f"damaged-{_last_number(folder) + 1}")


def salvage(folder: Path) -> None:
    """Recover `data` from the last `damaged-N`, if `data` is missing.

    The sender's id and the record numbers stay the same, so that the server recognises records that it has.
    If the row with the id cannot be read, nothing is recovered.
    """
    number = _last_number(folder)
    if number == 0 or (folder / "data").exists():
        return
    damaged, made = folder / f"damaged-{number}", folder / "data.tmp"
    with storage_errors(folder):
        shutil.rmtree(made, ignore_errors=True)
        made.mkdir()
        _link_photos(damaged / "photos", made / "photos")
    database = SpoolDatabase(made, reserve=folder / "reserve")
    try:
        create_tables(database)
        _copy_tables(damaged, database)
    finally:
        database.close()
    with storage_errors(folder):
        made.rename(folder / "data")


def _copy_tables(damaged: Path, database: SpoolDatabase) -> None:
    with contextlib.closing(open_for_reading(damaged)) as source:
        for table, columns in _TABLES.items():
            # Damaged records are copied too, also as text; their checksums reveal them later.
            names = ", ".join("text" if "text" in column else column for column in columns)
            marks = ", ".join("CAST(? AS TEXT)" if "text" in column else "?" for column in columns)
            insert = f"INSERT OR IGNORE INTO {table} ({names}) VALUES ({marks})"
            rows = _readable(source, table, columns)
            while some := [(insert, row) for row in itertools.islice(rows, _ROWS_AT_ONCE)]:
                database.write(*some)
            if not database.select("SELECT 1 FROM spool"):
                break
    known = database.select("SELECT 1 FROM spool")
    taken = "the readable records were recovered" if known else "nothing of it could be read"
    ((count,),) = database.select("SELECT coalesce(max(number) + 1, 0) FROM records")
    note = (count, count, f"the database was damaged: {taken}; it is in {damaged.name}")
    database.write(("INSERT INTO aside (first, stop, reason) VALUES (?, ?, ?)", note), durable=True)


def _readable(source: sqlite3.Connection, table: str, columns: tuple[str, ...]) -> Iterator[tuple[Any, ...]]:
    """Read the rows before the damage, then, from the end backwards, those after it."""
    key, last = columns[0], -1
    query = f"SELECT {', '.join(columns)} FROM {table} WHERE {key} > ? ORDER BY {key}"
    try:
        for row in source.execute(query, (last,)):
            yield row
            last = row[0]
    except sqlite3.DatabaseError:
        with contextlib.suppress(sqlite3.DatabaseError):
            yield from source.execute(f"{query} DESC", (last,))


def _link_photos(source: Path, target: Path) -> None:
    target.mkdir()
    for photo in source.iterdir() if source.is_dir() else ():
        try:
            os.link(photo, target / photo.name)
        except OSError:  # a file system without hard links
            shutil.copyfile(photo, target / photo.name)


def _last_number(folder: Path) -> int:
    numbers: Iterator[str] = (path.name.rpartition("-")[2] for path in folder.glob("damaged-*"))
    return max((int(number) for number in numbers if number.isdecimal()), default=0)
