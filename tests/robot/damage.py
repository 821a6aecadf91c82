"""Damages the database of a spool that is not in use."""

import sqlite3
from contextlib import closing
from pathlib import Path

PAGE = 1024


def database(spool: Path) -> Path:
    return spool / "data" / "spool.sqlite3"


def damage_record(spool: Path, number: int) -> None:
    """Change the text of a record, like a flipped bit."""
    with closing(sqlite3.connect(database(spool))) as connection:
        (text,) = connection.execute("SELECT text FROM records WHERE number = ?", (number,)).fetchone()
        changed = text[:3] + chr(ord(text[3]) ^ 1) + text[4:]
        connection.execute("UPDATE records SET text = ? WHERE number = ?", (changed, number))
        connection.commit()


def root_page(spool: Path, table: str) -> int:
    """Return the number of the first page of a table, from 1."""
    with closing(sqlite3.connect(database(spool))) as connection:
        return connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()[0]


def damage_page(spool: Path, number: int) -> None:
    """Overwrite a page with invalid content."""
    data = bytearray(database(spool).read_bytes())
    data[(number - 1) * PAGE : number * PAGE] = b"\xa5" * PAGE
    database(spool).write_bytes(data)
