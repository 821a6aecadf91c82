"""PostgreSQL: a server that several machines share."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from copy import copy
from datetime import UTC, datetime
from typing import Any, ClassVar

from sqlalchemy import URL, Connection, Engine, create_engine, event, text
from sqlalchemy.exc import DataError, DBAPIError
from sqlalchemy.orm import Session

from webapp.errors import DatabaseUnavailable, DiskFull, ExpMapError, StorageError, UsageError
from webapp.extras import extra
from webapp.store.backends.backend import (
    AGAIN_S,
    LOCK_MODE,
    MOVED,
    MOVING,
    TOGETHER,
    WAIT_S,
    Backend,
    has_moved,
    read_only,
    too_large,
)
from webapp.store.backends.photo_search import PhotoSearch
from webapp.store.backends.request_counts import RequestCounts
from webapp.store.backends.watching import CHANNEL, Listener

_log = logging.getLogger(__name__)

_OLDEST = 15
"""Minimum version of the server."""

_LOCK, _MIGRATION_LOCK = 0x657870_6D6170, 0x657870_6D6171
"""Numbers of the database's advisory locks: for writing, and for migrating."""

_GIVES_WAY_S = 1
"""Seconds for which a migration waits for a table that others use: all who need it next wait behind it."""

_LIMITS = {
    "statement_timeout": "60s",
    "lock_timeout": f"{WAIT_S}s",
    # The server drops connections of a lost machine after half a minute, and those of a hung process later.
    "idle_in_transaction_session_timeout": "600s",
    "tcp_keepalives_idle": "10",
    "tcp_keepalives_interval": "5",
    "tcp_keepalives_count": "3",
    "tcp_user_timeout": "25s",
}
_KEEPALIVE = {
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    # The options above have no effect while sent data is unacknowledged; this one has.
    "tcp_user_timeout": 25_000,
}

_CONNECT_S = 10
_POOL_S = 10
"""Seconds for which a thread waits for a connection."""

_RECYCLE_S = 1800
_SPARE = 4
"""Connections in addition to those of threads that answer requests, which may need two each."""

_AWAY = DatabaseUnavailable(
    "the database server cannot be reached", wait_s=AGAIN_S, hint="try again in a moment"
)
_BUSY = DatabaseUnavailable(
    "the database is busy: others have been writing for long", wait_s=AGAIN_S, hint="try again in a moment"
)
_TOO_SLOW = DatabaseUnavailable(
    "the database took too long, and was stopped", wait_s=AGAIN_S, hint="try again in a moment"
)
_TOO_MANY = DatabaseUnavailable(
    "the database has too many connections", wait_s=AGAIN_S, hint="ask the administrator of the server"
)
_SQLSTATES: Mapping[str, DatabaseUnavailable] = {
    "40001": _BUSY,
    "40P01": _BUSY,
    "53300": _TOO_MANY,
    "55P03": _BUSY,
    "57014": _TOO_SLOW,
}
"""Temporary errors, by their code in PostgreSQL."""

_OTHERS = """
SELECT count(*) FROM pg_stat_activity
WHERE datname = current_database() AND application_name = 'expmap' AND pid <> pg_backend_pid()
"""
_COUNTERS = """
SELECT table_name, column_name, pg_get_serial_sequence(quote_ident(table_name), column_name)
FROM information_schema.columns
WHERE table_schema = current_schema() AND left(column_default, 8) = 'nextval('
"""

_EXPANDED = "SELECT obj_description(to_regclass('alembic_version'), 'pg_class')"

_HAS_MOVED = f"""
SELECT EXISTS (
    SELECT FROM pg_class WHERE relname = '{MOVED}' AND relnamespace = current_schema()::text::regnamespace
)
"""

_LOCKED = ("40P01", "55P03")
_TOO_LARGE = "22003"
_DAMAGED = ("XX001", "XX002")
_FULL = "53100"
_READ_ONLY = "25006"
_PASSING = ("08", "53", "57")
"""Classes of codes of temporary errors: connection, insufficient resources, operator intervention."""


class Postgresql(Backend):
    """PostgreSQL, where writers hold a lock of the whole database, or share it and lock rows."""

    reading: ClassVar[Mapping[str, Any]] = {"isolation_level": "REPEATABLE READ"}

    def make_engine(self, url: URL, *, threads: int) -> Engine:
        """Create the engine, with a pool for that many threads."""
        with extra("cluster"):
            import psycopg  # noqa: F401 - the driver, which SQLAlchemy imports
        options = " ".join(f"-c {name}={value}" for name, value in _LIMITS.items())
        given = url.query.get("options", "")
        engine = create_engine(
            url,
            connect_args={
                "connect_timeout": _CONNECT_S,
                "application_name": "expmap",
                "client_encoding": "utf8",
                **_KEEPALIVE,
                "options": f"{options} {given}".strip(),
            },
            pool_pre_ping=True,
            pool_size=threads,
            max_overflow=threads + _SPARE,
            pool_timeout=_POOL_S,
            pool_recycle=_RECYCLE_S,
        )
        event.listen(engine, "begin", _begin)
        return engine

    def writer_lock(self) -> AbstractContextManager[object]:
        """Return a no-op: the server makes writers take turns."""
        return nullcontext()

    @contextmanager
    def migration(self, connection: Connection) -> Iterator[None]:
        """Hold the migration lock of the database."""
        _check(connection)
        connection.exec_driver_sql("SET statement_timeout = 0")
        connection.exec_driver_sql(f"SELECT pg_advisory_lock({_MIGRATION_LOCK})")
        connection.exec_driver_sql(f"SET lock_timeout = '{_GIVES_WAY_S}s'")
        connection.commit()
        try:
            yield
        finally:
            connection.rollback()
            connection.exec_driver_sql(f"SELECT pg_advisory_unlock({_MIGRATION_LOCK})")
            connection.exec_driver_sql("RESET statement_timeout")
            connection.exec_driver_sql("RESET lock_timeout")
            connection.commit()

    def gave_way(self, error: DBAPIError) -> bool:
        """Return whether it waited too long for a lock, or was the victim of a deadlock."""
        return getattr(error.orig, "sqlstate", None) in _LOCKED

    def expanded_since(self, connection: Connection) -> str | None:
        """Read the comment on Alembic's table."""
        found: str | None = connection.exec_driver_sql(_EXPANDED).scalar_one()
        return found

    def note_expanded(self, connection: Connection, since: str) -> None:
        """Write the comment if it differs."""
        if self.expanded_since(connection) != since:
            connection.exec_driver_sql(f"COMMENT ON TABLE alembic_version IS '{since}'")

    def error(self, error: DBAPIError, *, where: str) -> ExpMapError | None:
        """Convert an error of the server, or of the connection to it."""
        code = getattr(error.orig, "sqlstate", None) or ""
        if code == _TOO_LARGE:
            return too_large()
        if isinstance(error, DataError) and "NUL" in str(error.orig):
            return UsageError("a text has a character that cannot be stored", hint="remove it")
        if code == _FULL:
            return DiskFull(
                "the database is full: nothing was changed", where=where, hint="free some space on the disk"
            )
        if code in _DAMAGED:
            return StorageError(
                f"the database is damaged: {error.orig}", where=where, hint="restore a backup of the server"
            )
        if code == _READ_ONLY:
            return read_only(where)
        if code in _SQLSTATES:
            return _at(_SQLSTATES[code], where)
        lost = not code and (error.connection_invalidated or _is_of_connection(error))
        if lost or code[:2] in _PASSING:
            _log.info("the database server cannot be reached: %s", _first_line(error))
            return _at(_AWAY, where)
        if code[:2] in ("28", "3D", "42") and error.statement is None:  # refused when connecting
            return StorageError(f"the database refused: {_first_line(error)}", where=where)
        return None

    def moment(self, session: Session) -> datetime:
        """Return the time of the server, as the clocks of machines may differ."""
        found: datetime = session.execute(text("SELECT clock_timestamp()")).scalar_one()
        return found.astimezone(UTC)

    @contextmanager
    def time_limit(self, session: Session, seconds: float) -> Iterator[None]:
        """Let the server cancel each statement, including slow fetching of its rows, after that time."""
        until = time.monotonic() + seconds
        session.execute(text(f"SET LOCAL statement_timeout = {max(int(seconds * 1000), 1)}"))
        try:
            yield
        except DBAPIError as error:
            if time.monotonic() < until:
                raise
            raise TimeoutError from error

    def announce(self, connection: Connection, topic: str) -> None:
        connection.execute(text("SELECT pg_notify(:channel, :topic)"), {"channel": CHANNEL, "topic": topic})

    def listener(self, engine: Engine) -> Listener:
        """Create a listener with its own connection."""

        def connect() -> Any:
            connection = engine.raw_connection()
            driver: Any = connection.driver_connection
            connection.detach()  # from the pool
            driver.autocommit = True
            return driver

        return Listener(connect, error=engine.dialect.loaded_dbapi.Error)

    def request_counts(self, engine: Engine) -> RequestCounts:
        """Create the counter, which has its own table."""
        return RequestCounts(engine)

    def photo_search(self, engine: Engine) -> PhotoSearch:
        return PhotoSearch(engine)

    def insert(
        self, connection: Connection, table: str, *, columns: Sequence[str], rows: Sequence[Sequence[Any]]
    ) -> None:
        """Insert rows by `COPY`, which is fastest."""
        driver: Any = connection.connection.driver_connection
        dialect = connection.dialect
        statement = f"COPY {table} ({', '.join(columns)}) FROM STDIN"
        try:
            with driver.cursor() as cursor, cursor.copy(statement) as copy:
                for row in rows:
                    copy.write_row(row)
        except dialect.loaded_dbapi.Error as error:  # raised by the driver itself: wrap it like SQLAlchemy
            raise DBAPIError.instance(
                statement, None, error, dialect.loaded_dbapi.Error, dialect=dialect
            ) from error

    def unlimited(self, connection: Connection) -> None:
        """Lift the time limits until the end of the transaction."""
        for name in ("statement_timeout", "idle_in_transaction_session_timeout"):
            connection.exec_driver_sql(f"SET LOCAL {name} = 0")

    def is_open_elsewhere(self, connection: Connection) -> bool:
        """Return whether another process of the program is connected, on any machine."""
        return bool(connection.exec_driver_sql(_OTHERS).scalar_one())

    def last_ids(self, connection: Connection) -> dict[str, int]:
        """Return those of all tables with a sequence."""
        found = {}
        for table, _, counter in connection.exec_driver_sql(_COUNTERS).all():
            last, called = connection.exec_driver_sql(f"SELECT last_value, is_called FROM {counter}").one()
            found[str(table)] = int(last) if called else 0
        return found

    def keep_last_ids(self, connection: Connection, last: Mapping[str, int]) -> None:
        """Set the sequences; unused ones of empty tables are left alone."""
        for table, column, counter in connection.exec_driver_sql(_COUNTERS).all():
            query = f'SELECT coalesce(max("{column}"), 0) FROM "{table}"'
            at_least = max(last.get(table, 0), connection.exec_driver_sql(query).scalar_one())
            if at_least:
                connection.exec_driver_sql(f"SELECT setval('{counter}', {at_least})")


def _begin(connection: Connection) -> None:
    mode = connection.get_execution_options().get(LOCK_MODE)
    if mode is None:
        return
    kind = "_shared" if mode == TOGETHER else ""
    connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock{kind}({_LOCK})")
    # A separate statement after the lock, so that it sees what was committed while waiting for it.
    if mode != MOVING and connection.exec_driver_sql(_HAS_MOVED).scalar_one():
        raise has_moved()


def _check(connection: Connection) -> None:
    """Refuse a server that is too old, and a database not in UTF-8 or whose text order is not Python's."""
    version = int((connection.dialect.server_version_info or (0,))[0])
    if version < _OLDEST:
        raise StorageError(
            f"the database server is PostgreSQL {version}", hint=f"version {_OLDEST} or newer is needed"
        )
    query = "SELECT current_setting('server_encoding'), 'B' < 'a' AND 'a-b' < 'ab'"
    encoding, ordered = connection.exec_driver_sql(query).one()
    if encoding != "UTF8" or not ordered:
        raise StorageError(
            "the database has another encoding or another order of texts than the program needs",
            hint="make it by: CREATE DATABASE expmap TEMPLATE template0 ENCODING 'UTF8' LOCALE 'C'",
        )


def _is_of_connection(error: DBAPIError) -> bool:
    """Return whether the driver itself reports that there is no connection, or that it was lost."""
    return type(error.orig).__name__ in ("OperationalError", "InterfaceError", "ConnectionTimeout")


def _first_line(error: DBAPIError) -> str:
    return next(iter(str(error.orig).splitlines()), "")


def _at(kind: DatabaseUnavailable, where: str) -> DatabaseUnavailable:
    made = copy(kind)
    made.where = where
    return made
