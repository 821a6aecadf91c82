"""Marks in a database: it is being filled by a move, its records have moved elsewhere, or whose it is.

One that is being filled or has been left is never opened as a library, so that there are never two of one.
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
"""Names of their tables."""


@dataclass(frozen=True, slots=True)
class MovedMark:
    """Where the records are.

    Attributes
    ----------
    key : str
        Of the move.
    place : str
        For people.
    """

    key: str
    place: str


def filling_key(connection: Connection) -> str | None:
    """Return the key of the move that fills a database; None where none does."""
    if not inspect(connection).has_table(_FILLING.name):
        return None
    return str(connection.execute(select(_FILLING.c.key)).scalar_one())


def mark_filling(connection: Connection, key: str) -> None:
    """Mark a database as being filled."""
    _FILLING.create(connection)
    connection.execute(_FILLING.insert().values(key=key))


def unmark_filling(connection: Connection) -> None:
    """Say that a database is complete."""
    _FILLING.drop(connection, checkfirst=True)


def moved_mark(connection: Connection) -> MovedMark | None:
    """Return where the records of a database have gone; None where they are here."""
    if not inspect(connection).has_table(MOVED):
        return None
    key, place = connection.execute(select(_MOVED.c.key, _MOVED.c.place)).one()
    return MovedMark(key, place)


def mark_moved(connection: Connection, mark: MovedMark) -> None:
    """Say where the records have gone; from now on nobody writes here."""
    _MOVED.create(connection)
    connection.execute(_MOVED.insert().values(key=mark.key, place=mark.place))


def library_key(connection: Connection) -> str | None:
    """Return the key of the library in a database, which its folder has, too; None where it has none yet."""
    if not inspect(connection).has_table(_LIBRARY.name):
        return None
    return str(connection.execute(select(_LIBRARY.c.key)).scalar_one())


def set_library_key(connection: Connection, key: str) -> None:
    """Give a database the key of its library."""
    _LIBRARY.create(connection)
    connection.execute(_LIBRARY.insert().values(key=key))
