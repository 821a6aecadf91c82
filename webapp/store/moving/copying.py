"""Copies all records of a library from one database to another, table by table, and compares them.

A table is committed when it is complete and both sides have the same rows, so that an interrupted copy
resumes with the next table.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import (
    JSON,
    Connection,
    DateTime,
    Float,
    LargeBinary,
    MetaData,
    Table,
    Text,
    cast,
    func,
    inspect,
    select,
)
from sqlalchemy.exc import DBAPIError
from sqlalchemy.types import TypeEngine

from webapp.errors import StorageError, UsageError
from webapp.progress import Progress
from webapp.store.backends import photo_search, request_counts
from webapp.store.database import Database, backend_of
from webapp.store.library import has_tables, migrate
from webapp.store.moving import marks

_ROWS, _LARGE_ROWS = 2000, 50
"""Rows per batch, for plain tables and for those with rows of any size."""

_NOT_RECORDS = marks.MARKS | photo_search.TABLES | {"alembic_version", request_counts.TABLE}

Row = Sequence[Any]
Convert = Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class TableCopy:
    name: str
    rows: int
    sha256: str  # Hash of its rows, in the order of their keys


class SourceChanged(Exception):
    """The rows of a table have changed since it was copied: the copy has to start again."""


def prepare(target: Database, *, key: str, again: bool = False) -> None:
    """Create the tables in an empty database, and mark it as being filled.

    Args:
        key: Of the move; an interrupted move with the same key is resumed.
        again: Whether to discard what the move has copied so far.

    Raises:
        UsageError: The database is not empty.
        StorageError: The database cannot hold a library, or cannot be written.
    """
    has_tables(target)  # checks the database itself
    with target.moving() as connection:
        names, earlier = inspect(connection).get_table_names(), marks.filling_key(connection)
        if earlier not in (None, key) or (names and earlier is None):
            raise UsageError(
                "the database is not empty"
                if earlier is None
                else "another move has partly filled this database",
                where=target.name,
                hint="make an empty one: nothing in it is deleted",
            )
        if again:
            there = MetaData()
            there.reflect(connection, only=lambda name, _: name not in photo_search.TABLES)
            there.drop_all(connection)
        if again or earlier is None:
            marks.mark_filling(connection, key)
    migrate(target)


def copy_records(source: Connection, target: Database, *, progress: Progress) -> tuple[TableCopy, ...]:
    """Copy all tables to a database after `prepare`; tables that were copied earlier are compared.

    Args:
        source: In a transaction that sees a consistent snapshot.

    Raises:
        SourceChanged: The source has changed since an earlier copy.
        StorageError, DiskFull: The database refused rows, or returns different ones.
    """
    tables = _tables(source)
    rows = {table.name: _count(source, table) for table in tables}
    progress.size(sum(rows.values()))
    copies = []
    for table in tables:
        if rows[table.name]:
            progress.note(f"table {table.name}")
        with target.moving() as connection:
            copies.append(_copied(source, connection, table, progress=progress))
    last = backend_of(source).last_ids(source)
    with target.moving() as connection:
        target.backend.keep_last_ids(connection, last)
    return tuple(copies)


def _tables(source: Connection) -> list[Table]:
    """Return the tables of the library, those to which others refer first."""
    there = MetaData()
    there.reflect(source, only=lambda name, _: name not in _NOT_RECORDS)
    return there.sorted_tables


def _copied(source: Connection, target: Connection, table: Table, *, progress: Progress) -> TableCopy:
    """Copy a table unless it has rows already, and compare both sides."""
    is_new = not _count(target, table)
    digest, rows = _Digest(table), 0
    with closing(_batches(source, table)) as batches:
        for batch in batches:
            progress.check()
            if is_new:
                _insert(target, table, batch)
            digest.add(batch)
            rows += len(batch)
            progress.advance(len(batch))
    copy = TableCopy(table.name, rows, digest.sha256)
    if _read(target, table) == copy:
        return copy
    if not is_new:
        raise SourceChanged(table.name)
    raise StorageError(
        f"what was copied to the table {table.name} does not read back the same",
        hint="the library is as it was; please report this",
    )


def _read(connection: Connection, table: Table) -> TableCopy:
    digest, rows = _Digest(table), 0
    with closing(_batches(connection, table)) as batches:
        for batch in batches:
            digest.add(batch)
            rows += len(batch)
    return TableCopy(table.name, rows, digest.sha256)


def _count(connection: Connection, table: Table) -> int:
    return connection.execute(select(func.count()).select_from(table)).scalar_one()


def _batches(connection: Connection, table: Table) -> Generator[Sequence[Row]]:
    """Read all rows in the order of their keys, with JSON as the stored text."""
    columns = [cast(c, Text).label(c.name) if isinstance(c.type, JSON) else c for c in table.columns]
    large = any(isinstance(c.type, JSON | LargeBinary) for c in table.columns)
    query = select(*columns).order_by(*table.primary_key.columns)
    options = {"yield_per": _LARGE_ROWS if large else _ROWS}
    with connection.execute(query, execution_options=options) as result:
        yield from result.partitions()


def _insert(connection: Connection, table: Table, batch: Sequence[Row]) -> None:
    """Insert rows; times are first converted like by SQLAlchemy, for SQLite to text."""
    quote = connection.dialect.identifier_preparer.quote
    names = [quote(column.name) for column in table.columns]
    write = [
        DateTime().dialect_impl(connection.dialect).bind_processor(connection.dialect)
        if isinstance(column.type, DateTime)
        else None
        for column in table.columns
    ]
    if any(write):
        batch = [_by_column(row, write) for row in batch]
    try:
        backend_of(connection).insert(connection, quote(table.name), columns=names, rows=batch)
    except DBAPIError as error:
        known = backend_of(connection).error(error, where=table.name)
        if isinstance(known, StorageError):
            raise known from error
        reason = next(iter(str(error.orig).splitlines()), "")
        raise StorageError(
            f"the database rejected rows: {reason}",
            where=f"table {table.name}",
            hint="the library is as it was",
        ) from error


class _Digest:
    """A hash of rows that is the same for every kind of database."""

    def __init__(self, table: Table) -> None:
        self._hash = hashlib.sha256()
        self._plain = [_plain(column.type) for column in table.columns]

    def add(self, batch: Sequence[Row]) -> None:
        for row in batch:
            self._hash.update(repr(_by_column(row, self._plain)).encode())

    @property
    def sha256(self) -> str:
        """Hash of all rows so far, hexadecimal."""
        return self._hash.hexdigest()


def _plain(kind: TypeEngine[Any]) -> Convert | None:
    """Return a function that normalises a column's values across databases; None if not needed."""
    if isinstance(kind, Float):
        return _without_sign_of_zero
    if isinstance(kind, DateTime):
        return datetime.isoformat
    return _hash_of if isinstance(kind, LargeBinary) else None


def _without_sign_of_zero(value: float) -> float:
    """Normalise -0.0, which SQLite stores as 0.0."""
    return value + 0.0


def _hash_of(value: bytes) -> bytes:
    return hashlib.sha256(value).digest()


def _by_column(row: Row, convert: Sequence[Convert | None]) -> tuple[Any, ...]:
    return tuple(
        value if change is None or value is None else change(value)
        for value, change in zip(row, convert, strict=True)
    )
