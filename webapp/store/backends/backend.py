"""The interface to a kind of database, for all that goes beyond portable SQL."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import URL, Connection, Engine
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from webapp.errors import DatabaseUnavailable, ExpMapError, NotFound, StorageError
from webapp.store.backends.photo_search import PhotoSearch
from webapp.store.backends.request_counts import RequestCounts
from webapp.store.backends.watching import Listener

WAIT_S = 30
"""Seconds for which a writer waits for others."""

AGAIN_S = 2
"""Seconds after which clients try again what the database refused."""

LOCK_MODE = "lock_mode"
"""Option of writing connections: `ALONE`, or `TOGETHER` with others that lock the rows they change."""

ALONE, TOGETHER = "alone", "together"

MOVING = "moving"
"""Like `ALONE`, but also in a database from which the records have moved."""

MOVED = "library_moved"
"""Table that marks a database from which the records have moved: writing is refused."""


class Backend(ABC):
    reading: ClassVar[Mapping[str, Any]] = {}
    """Options of read-only connections, so that each sees a consistent snapshot."""

    @abstractmethod
    def make_engine(self, url: URL, *, threads: int) -> Engine:
        """Create the engine, without connecting yet."""

    @abstractmethod
    def writer_lock(self) -> AbstractContextManager[object]:
        """Create the lock by which the writing threads of a process take turns."""

    @abstractmethod
    def migration(self, connection: Connection) -> AbstractContextManager[None]:
        """Check the database, and prevent concurrent migrations."""

    def gave_way(self, error: DBAPIError) -> bool:
        """Return whether a migration has failed only because others use a table."""
        return False

    @abstractmethod
    def expanded_since(self, connection: Connection) -> str | None:
        """Return the schema version since which the tables have only been expanded, as stored by
        `note_expanded`; None if it was not stored."""

    @abstractmethod
    def note_expanded(self, connection: Connection, since: str) -> None:
        """Store that version in the database, for older programs on other machines."""

    @abstractmethod
    def error(self, error: DBAPIError, *, where: str) -> ExpMapError | None:
        """Convert an error of the database to one of the program; None for a bug of the program."""

    @abstractmethod
    def moment(self, session: Session) -> datetime:
        """Return the time by the clock that all processes using the database share."""

    @abstractmethod
    def time_limit(self, session: Session, seconds: float) -> AbstractContextManager[None]:
        """Let the database cancel the statements of the block after some seconds.

        Raises:
            TimeoutError: They took longer.
        """

    @abstractmethod
    def announce(self, connection: Connection, topic: str) -> None:
        """Notify the watchers of a topic once the transaction is committed."""

    @abstractmethod
    def listener(self, engine: Engine) -> Listener | None:
        """Create a listener for announcements; None for a database without them, which must be polled."""

    @abstractmethod
    def request_counts(self, engine: Engine) -> RequestCounts | None:
        """Create the counter of requests of all machines; None: a single machine counts in memory."""

    @abstractmethod
    def photo_search(self, engine: Engine) -> PhotoSearch | None:
        """Create the search for similar photos; None if the database has none: it is done in memory."""

    @abstractmethod
    def insert(
        self, connection: Connection, table: str, *, columns: Sequence[str], rows: Sequence[Sequence[Any]]
    ) -> None:
        """Insert many rows of plain values by the driver's bulk method; names are quoted where necessary."""

    @abstractmethod
    def unlimited(self, connection: Connection) -> None:
        """Lift the time limit of a transaction."""

    @abstractmethod
    def is_open_elsewhere(self, connection: Connection) -> bool:
        """Return whether other processes are connected; False if that is unknown."""

    @abstractmethod
    def last_ids(self, connection: Connection) -> dict[str, int]:
        """Return the last id issued, including deleted ones, for each table that keeps track of it."""

    @abstractmethod
    def keep_last_ids(self, connection: Connection, last: Mapping[str, int]) -> None:
        """Make tables continue after their last ids, or after the largest existing id."""


def has_moved() -> StorageError:
    """Return the error for a process that still has the old database open after a move."""
    return StorageError(
        "the records of this library have moved to another database: nothing was changed",
        hint="start the program again: it says where they are",
    )


def read_only(where: str) -> DatabaseUnavailable:
    return DatabaseUnavailable(
        "the database is read-only",
        wait_s=AGAIN_S,
        where=where,
        hint="ask the administrator of the server",
    )


def too_large() -> NotFound:
    """Return the error for an id from a client that is too large for any column, so that nothing has it."""
    return NotFound("the number is too large", hint="check the address")
