"""What the program needs of a database, besides SQL that all of them understand."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import URL, Connection, Engine
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from webapp.errors import ExpMapError, NotFound, StorageError
from webapp.store.backends.photo_search import PhotoSearch
from webapp.store.backends.request_counts import RequestCounts
from webapp.store.backends.watching import Listener

WAIT_S = 30
"""How long a writer waits for the others."""

LOCK_MODE = "lock_mode"
"""Option of connections that write: `ALONE`, or `TOGETHER` with others that lock the rows they change."""

ALONE, TOGETHER = "alone", "together"

MOVING = "moving"
"""As `ALONE`, also in a database that the records have left."""

MOVED = "library_moved"
"""Table that marks a database that the records have left: nobody writes there any more."""


class Backend(ABC):
    """A kind of database."""

    reading: ClassVar[Mapping[str, Any]] = {}
    """Options of connections that only read, so that they see one state of the database."""

    @abstractmethod
    def make_engine(self, url: URL, *, threads: int) -> Engine:
        """Make the engine; nothing is connected yet.

        Parameters
        ----------
        threads : int
            That use it at once.

        Raises
        ------
        MissingPart
            The driver is not installed.
        """

    @abstractmethod
    def writer_lock(self) -> AbstractContextManager[object]:
        """Make what the threads of a process that write take turns by."""

    @abstractmethod
    def migration(self, connection: Connection) -> AbstractContextManager[None]:
        """Check the database, and keep others from migrating it at the same time.

        Raises
        ------
        StorageError
            The database cannot hold a library.
        """

    @abstractmethod
    def expanded_since(self, connection: Connection) -> str | None:
        """Return the version of tables which those that are there have only added to, as `note_expanded`
        has kept it; None where nobody has."""

    @abstractmethod
    def note_expanded(self, connection: Connection, since: str) -> None:
        """Keep that version with the tables, for older programs on other machines."""

    @abstractmethod
    def error(self, error: DBAPIError, *, where: str) -> ExpMapError | None:
        """Say in words what the database refused; None for a bug of the program."""

    @abstractmethod
    def moment(self, session: Session) -> datetime:
        """Return the time by the one clock that all who use the database share."""

    @abstractmethod
    def time_limit(self, session: Session, seconds: float) -> AbstractContextManager[None]:
        """Make the database stop its work on the statements of the block.

        Raises
        ------
        TimeoutError
            It took longer.
        """

    @abstractmethod
    def announce(self, connection: Connection, topic: str) -> None:
        """Wake who watches a topic, once the transaction is kept."""

    @abstractmethod
    def listener(self, engine: Engine) -> Listener | None:
        """Make what hears announcements; None for a database that has none, where one has to look."""

    @abstractmethod
    def request_counts(self, engine: Engine) -> RequestCounts | None:
        """Make what counts requests for all machines; None for a database of one, which counts in memory."""

    @abstractmethod
    def photo_search(self, engine: Engine) -> PhotoSearch | None:
        """Make what searches for similar photos; None for a database that cannot: it is done in memory."""

    @abstractmethod
    def insert(
        self, connection: Connection, table: str, *, columns: Sequence[str], rows: Sequence[Sequence[Any]]
    ) -> None:
        """Insert many rows of plain values, in the driver's own way; names are quoted where SQL needs it."""

    @abstractmethod
    def unlimited(self, connection: Connection) -> None:
        """Let a transaction take as long as it needs."""

    @abstractmethod
    def is_open_elsewhere(self, connection: Connection) -> bool:
        """Return whether other processes are connected; False where the database does not know."""

    @abstractmethod
    def last_ids(self, connection: Connection) -> dict[str, int]:
        """Return the last id that was given, deleted ones included, by the names of tables that keep it."""

    @abstractmethod
    def keep_last_ids(self, connection: Connection, last: Mapping[str, int]) -> None:
        """Have tables go on after their last ids, or after the largest that is there."""


def has_moved() -> StorageError:
    """Return the error for a process that still has the old database open after a move."""
    return StorageError(
        "the records of this library have moved to another database: nothing was changed",
        hint="start the program again: it says where they are",
    )


def too_large() -> NotFound:
    """Make the error for an id that no column can hold, and that therefore nothing has: clients send any."""
    return NotFound("the number is too large", hint="check the address")
