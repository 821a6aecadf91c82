"""Marks in a database: it is being filled by a move, its records have moved elsewhere, or the library's key.

A database with one of the first two is never opened as a library, so that no two copies are ever in use.
"""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Column, Connection, MetaData, String, Table, inspect, select

from webapp.store.backends.backend import MOVED

_METADATA = MetaData()
_FILLING = Table("library_filling", _METADATA, Column("key", String, nullable=False))
_MOVED = Table(
    MOVED, _METADATA, Column("key", String, nullable=False), Column("place", String, nullable=False)
)
_LIBRARY = Table("library_key", _METADATA, Column("key", String, nullable=False))

MARKS = frozenset(_METADATA.tables)
"""Names of the tables of marks."""


@dataclass(frozen=True, slots=True)
class MovedMark:
    key: str  # Of the move
    place: str  # Description of the location, for messages


def filling_key(connection: Connection) -> str | None:
    """Return the key of the move that is filling a database; None if there is none."""
    if not inspect(connection).has_table(_FILLING.name):
        return None
    return str(connection.execute(select(_FILLING.c.key)).scalar_one())


def mark_filling(connection: Connection, key: str) -> None:
    _FILLING.create(connection)
    connection.execute(_FILLING.insert().values(key=key))


def unmark_filling(connection: Connection) -> None:
    """Remove the mark of being filled: the database is complete."""
    _FILLING.drop(connection, checkfirst=True)


def moved_mark(connection: Connection) -> MovedMark | None:
    """Return where the records of a database have moved; None if they have not."""
    if not inspect(connection).has_table(MOVED):
        return None
    key, place = connection.execute(select(_MOVED.c.key, _MOVED.c.place)).one()
    return MovedMark(key, place)


def mark_moved(connection: Connection, mark: MovedMark) -> None:
    """Record where the records have moved; from now on, writing here is refused."""
    _MOVED.create(connection)
    connection.execute(_MOVED.insert().values(key=mark.key, place=mark.place))


def library_key(connection: Connection) -> str | None:
    """Return the key of the library in a database, which its folder has, too; None if it has none yet."""
    if not inspect(connection).has_table(_LIBRARY.name):
        return None
    return str(connection.execute(select(_LIBRARY.c.key)).scalar_one())


def set_library_key(connection: Connection, key: str) -> None:
    _LIBRARY.create(connection)
    connection.execute(_LIBRARY.insert().values(key=key))
