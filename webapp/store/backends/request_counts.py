"""Counts of requests for rate limits in PostgreSQL, shared by all machines."""

from __future__ import annotations

import threading
import time

from sqlalchemy import Engine, text
from sqlalchemy.exc import DBAPIError

TABLE = "request_count"
"""Not among the library's records: not copied, and empty after a crash of the server (`UNLOGGED`)."""

_LOCK = 0x657870_6D6172
"""Number of the advisory lock for creating the table."""

_TIDY_S = 60.0

_READ_ONLY = "25006"
"""Error code of PostgreSQL: `read_only_sql_transaction`."""

_MAKE = (
    f"SELECT pg_advisory_xact_lock({_LOCK})",  # concurrent creation would fail
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
    """Counts in windows of fixed length, by the clock of the server; each hit takes one statement.

    It raises errors of SQLAlchemy: see `Database.translated_errors`.
    """

    def __init__(self, engine: Engine) -> None:
        self._making = engine
        self._engine = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._turn = threading.Lock()
        self._is_made = False
        self._tidy_at = time.monotonic() + _TIDY_S

    def hit(self, key: str, *, seconds: float, amount: int = 1) -> int | None:
        """Count a request, in a window that begins with its first one; return the count.

        None if the database is read-only, so that nothing was counted.
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

    def count_of(self, key: str) -> tuple[int, float]:
        """Return the count, and the seconds until its window ends; zeros if there is none."""
        self._prepare()
        with self._engine.connect() as connection:
            found = connection.execute(_GET, {"key": key}).one_or_none()
        return (0, 0.0) if found is None else (int(found[0]), float(found[1]))

    def forget(self, key: str | None = None) -> int:
        """Delete a count, or all; return how many were deleted."""
        self._prepare()
        where = "" if key is None else " WHERE key = :key"
        with self._engine.connect() as connection:
            return connection.execute(
                text(f"DELETE FROM {TABLE}{where}"), {"key": key} if key else {}
            ).rowcount

    def _prepare(self) -> None:
        """Create the table if it does not exist."""
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
