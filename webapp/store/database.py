"""Opens the database and hands out sessions."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import DatabaseError, DataError, NoResultFound, OperationalError
from sqlalchemy.orm import Session

from webapp.errors import DiskFull, NotFound, StorageError

Writes = Callable[[], AbstractContextManager[Session]]
"""Opens a session that writes: `Database.write`, or that of a job that holds its lease."""

_WAIT_S = 30
"""How long a writer waits for the others."""


class Database:
    """The library's database.

    Parameters
    ----------
    url : str
        As SQLAlchemy takes it: `sqlite:////path/library.db` or `postgresql+psycopg://...`.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.engine = _engine(url)
        self._writing = self.engine.execution_options(writes=True)
        self._turn: AbstractContextManager[object] = (
            threading.RLock() if self.engine.dialect.name == "sqlite" else nullcontext()
        )

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Return a session that sees one state of the database; its changes are not kept.

        Raises
        ------
        NotFound
            What the block gets by its id is not there any more.
        StorageError
            The database cannot be read.
        """
        with translated_errors(self.url), Session(self.engine) as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Return a session whose changes are on disk, all together, when the block ends without an error.

        Writers take turns: a SQLite database is locked from the first statement on, so that what the
        session reads stays true until it has written.

        Raises
        ------
        NotFound
            What the block gets by its id is not there any more.
        StorageError
            The database cannot be written.
        """
        # One thread at a time asks SQLite, which would have all that wait ask again and again.
        with (
            self._turn,
            translated_errors(self.url),
            Session(self._writing, expire_on_commit=False) as session,
        ):
            yield session
            session.commit()

    def close(self) -> None:
        """Let go of all connections."""
        self.engine.dispose()


def _engine(url: str) -> Engine:
    sqlite = make_url(url).get_backend_name() == "sqlite"
    engine = create_engine(url, connect_args={"timeout": _WAIT_S} if sqlite else {}, pool_pre_ping=not sqlite)
    if sqlite:
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # the driver's own way of beginning would come too late
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


@contextmanager
def translated_errors(url: str) -> Iterator[None]:
    """Raise errors of the database in the block as those of the program.

    Raises
    ------
    NotFound
        The record does not exist, or was deleted.
    StorageError
        The database is damaged, or cannot be read or written.
    """
    try:
        yield
    except (OverflowError, DataError) as error:
        # Clients send ids of any size; one that no column can hold is one that nothing has.
        raise NotFound("the number is too large", hint="check the address") from error
    except NoResultFound as error:
        # What an earlier session has found: its map was deleted, or its account, before this one began.
        raise NotFound("somebody has deleted this in the meantime", hint="reload the page") from error
    except DatabaseError as error:
        if type(error) not in (DatabaseError, OperationalError):
            raise
        where = make_url(url).render_as_string(hide_password=True)
        if getattr(error.orig, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            raise DiskFull(
                "the database is full: nothing was changed", where=where, hint="free some space on the disk"
            ) from error
        if type(error) is DatabaseError:
            raise StorageError(
                f"the database is damaged: {error.orig}", where=where, hint="restore a backup: expmap restore"
            ) from error
        raise StorageError(
            f"the database refused: {error.orig}", where=where, hint="is the disk full or read-only?"
        ) from error
