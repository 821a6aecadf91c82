"""SQLite: a file in the library's folder."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.exc import DatabaseError, DBAPIError, OperationalError
from sqlalchemy.orm import Session

from webapp.errors import DiskFull, ExpMapError, StorageError
from webapp.store.backends.backend import LOCK_MODE, MOVED, MOVING, WAIT_S, Backend, has_moved, read_only
from webapp.store.clock import now

_STEPS = 20_000
"""Instructions of SQLite's virtual machine between two checks of the clock: some milliseconds."""


_PRIMARY = 0xFF
"""Bits of an error code without its details."""

_NOT_WRITTEN = (
    sqlite3.SQLITE_IOERR_WRITE,
    sqlite3.SQLITE_IOERR_FSYNC,
    sqlite3.SQLITE_IOERR_DIR_FSYNC,
    sqlite3.SQLITE_IOERR_TRUNCATE,
    sqlite3.SQLITE_IOERR_DELETE,
)
"""Errors of a file that was opened before its disk turned read-only."""


class Sqlite(Backend):
    """SQLite, with one writer at a time: it locks the database from the first statement on."""

    def make_engine(self, url: URL, *, threads: int) -> Engine:
        """Create the engine; `threads` does not matter, as SQLite does not limit connections."""
        engine = create_engine(url, connect_args={"timeout": WAIT_S})
        event.listen(engine, "connect", _prepare)
        event.listen(engine, "begin", _begin)
        return engine

    def writer_lock(self) -> AbstractContextManager[object]:
        """Create a lock, so that waiting threads do not poll SQLite."""
        return threading.RLock()

    @contextmanager
    def migration(self, connection: Connection) -> Iterator[None]:
        """Suspend foreign keys: recreating a table would delete what refers to it. The library is locked."""
        driver = connection.connection.driver_connection
        assert isinstance(driver, sqlite3.Connection)
        driver.execute("PRAGMA foreign_keys=OFF")
        try:
            yield
        finally:
            connection.rollback()  # the setting cannot be changed within a transaction
            driver.execute("PRAGMA foreign_keys=ON")

    def expanded_since(self, connection: Connection) -> None:
        """Return None: a single machine has a single version of the program."""

    def note_expanded(self, connection: Connection, since: str) -> None:
        """Do nothing."""

    def error(self, error: DBAPIError, *, where: str) -> ExpMapError | None:
        if type(error) not in (DatabaseError, OperationalError):
            return None
        code = getattr(error.orig, "sqlite_errorcode", None) or 0
        if code & _PRIMARY == sqlite3.SQLITE_READONLY or code in _NOT_WRITTEN:
            return read_only(where)
        if code == sqlite3.SQLITE_FULL:
            return DiskFull(
                "the database is full: nothing was changed", where=where, hint="free some space on the disk"
            )
        if type(error) is DatabaseError:
            return StorageError(
                f"the database is damaged: {error.orig}",
                where=where,
                hint="restore a backup: expmap restore",
            )
        return StorageError(
            f"the database refused: {error.orig}", where=where, hint="is the disk full or read-only?"
        )

    def moment(self, session: Session) -> datetime:
        """Return the time of this machine, which is the only one."""
        return now()

    @contextmanager
    def time_limit(self, session: Session, seconds: float) -> Iterator[None]:
        """Interrupt SQLite when the time is over."""
        until = time.monotonic() + seconds
        driver = session.connection().connection.driver_connection
        assert isinstance(driver, sqlite3.Connection)
        driver.set_progress_handler(lambda: time.monotonic() > until, _STEPS)
        try:
            yield
        except OperationalError as error:
            if time.monotonic() < until:
                raise
            raise TimeoutError from error
        finally:
            driver.set_progress_handler(None, 0)

    def announce(self, connection: Connection, topic: str) -> None:
        """Do nothing."""

    def listener(self, engine: Engine) -> None:
        """Return None: polling a local file costs little."""

    def request_counts(self, engine: Engine) -> None:
        """Return None: each process counts on its own, which saves writing."""

    def photo_search(self, engine: Engine) -> None:
        """Return None: photos are compared in memory."""

    def insert(
        self, connection: Connection, table: str, *, columns: Sequence[str], rows: Sequence[Sequence[Any]]
    ) -> None:
        """Insert rows by the driver; SQLAlchemy would take three times as long to prepare them."""
        marks = ", ".join("?" * len(columns))
        statement = f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({marks})"
        connection.exec_driver_sql(statement, [tuple(row) for row in rows])

    def unlimited(self, connection: Connection) -> None:
        """Do nothing: there is no limit."""

    def is_open_elsewhere(self, connection: Connection) -> bool:
        """Return False: SQLite does not know."""
        return False

    def last_ids(self, connection: Connection) -> dict[str, int]:
        """Return those of tables that never reuse ids (AUTOINCREMENT); others continue after the largest."""
        rows = connection.exec_driver_sql("SELECT name, seq FROM sqlite_sequence")
        return {str(name): int(last) for name, last in rows}

    def keep_last_ids(self, connection: Connection, last: Mapping[str, int]) -> None:
        """Set those of tables that never reuse ids."""
        tables = connection.exec_driver_sql("SELECT name FROM sqlite_master WHERE sql LIKE '%AUTOINCREMENT%'")
        there = self.last_ids(connection)
        for (name,) in tables.all():
            at_least = max(last.get(name, 0), there.get(name, 0))
            connection.exec_driver_sql("DELETE FROM sqlite_sequence WHERE name = ?", (name,))
            connection.exec_driver_sql("INSERT INTO sqlite_sequence VALUES (?, ?)", (name, at_least))


def _prepare(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # the driver would begin transactions too late
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin(connection: Connection) -> None:
    mode = connection.get_execution_options().get(LOCK_MODE)
    connection.exec_driver_sql("BEGIN" if mode is None else "BEGIN IMMEDIATE")
    if mode in (None, MOVING):
        return
    if connection.exec_driver_sql(f"SELECT 1 FROM sqlite_master WHERE name = '{MOVED}'").first():
        raise has_moved()
