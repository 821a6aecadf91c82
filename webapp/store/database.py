"""Opens the database and its sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import datetime

from sqlalchemy import Connection, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoResultFound
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.orm import Session

from webapp.errors import DatabaseUnavailable, NotFound, UsageError
from webapp.store.backends.backend import ALONE, LOCK_MODE, MOVING, TOGETHER, Backend, too_large
from webapp.store.backends.postgresql import Postgresql
from webapp.store.backends.sqlite import Sqlite
from webapp.store.backends.watching import Polling, Watch

Writes = Callable[[], AbstractContextManager[Session]]
"""Opens a writing session: `Database.write`, or that of a job that holds its lease."""

_BACKENDS: dict[str, Backend] = {"sqlite": Sqlite(), "postgresql": Postgresql()}
_DRIVERS = ("sqlite", "postgresql+psycopg")

THREADS = 8
"""Default number of threads that use a database in parallel."""


class Database:
    """The library's database.

    Args:
        url: In the form of SQLAlchemy: `sqlite:////path/library.db` or `postgresql+psycopg://...`.

    Raises:
        UsageError: The address is malformed, or of a database that is not supported.
        MissingPart: The driver of PostgreSQL is not installed.
    """

    def __init__(self, url: str, *, threads: int = THREADS) -> None:
        try:
            made = make_url(url)
        except ArgumentError as error:
            raise UsageError("this is no address of a database", hint=_url_hint()) from error
        if made.drivername not in _DRIVERS:
            raise UsageError(f"{made.drivername!r} is not a supported database", hint=_url_hint())
        self.name = made.render_as_string(hide_password=True)
        self.backend = _BACKENDS[made.get_backend_name()]
        self.engine = self.backend.make_engine(made, threads=threads)
        reading = self.backend.reading  # setting options costs a little per connection
        self._reading = self.engine.execution_options(**reading) if reading else self.engine
        self._alone = self.engine.execution_options(**{LOCK_MODE: ALONE})
        self._together = self.engine.execution_options(**{LOCK_MODE: TOGETHER})
        self._for_moves = self.engine.execution_options(**{LOCK_MODE: MOVING})
        self._writer_lock = self.backend.writer_lock()
        self._listener = self.backend.listener(self.engine)
        self.request_counts = self.backend.request_counts(self.engine)
        self.photo_search = self.backend.photo_search(self.engine)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Yield a session that sees a consistent snapshot; its changes are discarded."""
        with self.translated_errors(), Session(self._reading) as session:
            yield session

    @contextmanager
    def write(self, *, locks_rows: bool = False) -> Iterator[Session]:
        """Yield a session whose changes are committed together when the block ends without an error.

        Writers take turns: the database is locked from the first statement on, so that what the session
        reads stays valid until it has written.

        Args:
            locks_rows: Whether the block locks the rows on which its changes depend (`with_for_update`)
                before it reads them. If the database supports that, such blocks do not wait for each other.
        """
        engine = self._together if locks_rows else self._alone
        with self._writer_lock, self.translated_errors(), Session(engine, expire_on_commit=False) as session:
            yield session
            session.commit()

    @contextmanager
    def moving(self) -> Iterator[Connection]:
        """Block all other writers without a time limit, also in a database from which the records have moved.

        The changes of the block are committed together when it ends without an error.
        """
        with self._writer_lock, self.translated_errors(), self._for_moves.begin() as connection:
            self.backend.unlimited(connection)
            yield connection

    def watch(self, topic: str, *, look_s: float) -> AbstractContextManager[Watch]:
        """Watch a topic for changes in the block; see `announce`.

        Args:
            look_s: Minimum seconds between two looks, and polling interval of a database without
                announcements.
        """
        if self._listener is None:
            return nullcontext(Polling(look_s))
        return self._listener.watch(topic, look_s=look_s)

    def close(self) -> None:
        if self._listener is not None:
            self._listener.close()
        self.engine.dispose()

    @contextmanager
    def translated_errors(self) -> Iterator[None]:
        """Convert errors of the database in the block to those of the program.

        Raises:
            NotFound: The record does not exist, or was deleted.
            StorageError: The database is damaged, or cannot be read or written.
        """
        try:
            yield
        except OverflowError as error:
            raise too_large() from error
        except NoResultFound as error:
            # A record that an earlier session found was deleted since, perhaps with its map or account.
            raise NotFound("this was deleted in the meantime", hint="reload the page") from error
        except PoolTimeout as error:
            raise DatabaseUnavailable(
                "all connections to the database are in use", wait_s=1, hint="try again in a moment"
            ) from error
        except DBAPIError as error:
            known = self.backend.error(error, where=self.name)
            if known is None:
                raise
            raise known from error


def backend_of(who: Session | Connection) -> Backend:
    return _BACKENDS[(who.get_bind() if isinstance(who, Session) else who).dialect.name]


def moment(session: Session) -> datetime:
    """Return the time by the clock that all processes using the database share."""
    return backend_of(session).moment(session)


def announce(connection: Connection, topic: str) -> None:
    """Notify the watchers of a topic on all machines once the transaction is committed."""
    backend_of(connection).announce(connection, topic)


def _url_hint() -> str:
    return "write postgresql+psycopg://user:password@host/database"
