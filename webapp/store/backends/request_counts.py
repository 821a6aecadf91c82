"""Counts of requests, for limits on their rate, in a PostgreSQL database: all machines count together."""

from __future__ import annotations

import threading
import time

from sqlalchemy import Engine, text
from sqlalchemy.exc import DBAPIError

TABLE = "request_count"
"""Is no record of the library: not copied, and empty after a crash of the server (`UNLOGGED`)."""

_LOCK = 0x657870_6D6172
"""Number of the advisory lock of who makes the table."""

_TIDY_S = 60.0

_READ_ONLY = "25006"
"""Of the errors of PostgreSQL: `read_only_sql_transaction`."""

_MAKE = (
    f"SELECT pg_advisory_xact_lock({_LOCK})",  # or two that make it at the same time would fail
    f"CREATE UNLOGGED TABLE IF NOT EXISTS {TABLE} "
    "(key text PRIMARY KEY, hits integer NOT NULL, ends_at timestamptz NOT NULL) WITH (fillfactor = 50)",
)
_HIT = text(f"""
INSERT INTO {TABLE} AS had (key, hits, ends_at)
VALUES (:key, :amount, clock_timestamp() + make_interval(secs => :seconds))
ON CONFLICT (key) DO UPDATE SET
    hits = CASE WHEN had.ends_at > clock_timestamp() THEN had.hits ELSE 0 END + :amount,
    ends_at = CASE WHEN had.ends_at > clock_timestamp() THEN had.ends_at ELSE excluded.ends_at END
RETURNING hits
""")
_GET = text(f"""
SELECT hits, extract(epoch FROM ends_at - clock_timestamp())
FROM {TABLE} WHERE key = :key AND ends_at > clock_timestamp()
""")
_TIDY = text(f"""
DELETE FROM {TABLE} WHERE key IN
(SELECT key FROM {TABLE} WHERE ends_at <= clock_timestamp() FOR UPDATE SKIP LOCKED)
""")


class RequestCounts:
    """Counts in windows of fixed length, by the clock of the server; a request costs one statement.

    Errors are those of SQLAlchemy: see `Database.translated_errors`.
    """

    def __init__(self, engine: Engine) -> None:
        self._making = engine
        self._engine = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._turn = threading.Lock()
        self._is_made = False
        self._tidy_at = time.monotonic() + _TIDY_S

    def hit(self, key: str, *, seconds: float, amount: int = 1) -> int | None:
        """Count, in a window that begins with its first request; returns how many it has now.

        None where the database is read-only, and nothing was counted.
        """
        try:
            self._prepare()
            with self._engine.connect() as connection:
                values = {"key": key, "seconds": seconds, "amount": amount}
                hits: int = connection.execute(_HIT, values).scalar_one()
                if self._is_time_to_tidy():
                    connection.execute(_TIDY)
        except DBAPIError as error:
            if getattr(error.orig, "sqlstate", None) == _READ_ONLY:
                return None
            raise
        return hits

    def look(self, key: str) -> tuple[int, float]:
        """Return how many were counted, and the seconds until the window ends; zeros where there is none."""
        self._prepare()
        with self._engine.connect() as connection:
            found = connection.execute(_GET, {"key": key}).one_or_none()
        return (0, 0.0) if found is None else (int(found[0]), float(found[1]))

    def forget(self, key: str | None = None) -> int:
        """Delete a count, or all; returns how many there were."""
        self._prepare()
        where = "" if key is None else " WHERE key = :key"
        with self._engine.connect() as connection:
            return connection.execute(
                text(f"DELETE FROM {TABLE}{where}"), {"key": key} if key else {}
            ).rowcount

    def _prepare(self) -> None:
        """Make the table where there is none."""
        with self._turn:
            if not self._is_made:
                with self._making.begin() as connection:
                    for statement in _MAKE:
                        connection.exec_driver_sql(statement)
                self._is_made = True

    def _is_time_to_tidy(self) -> bool:
        with self._turn:
            now = time.monotonic()
            if now < self._tidy_at:
                return False
            self._tidy_at = now + _TIDY_S
            return True
