"""Counters of requests for rate limits: in the memory of a process, or in the database shared by machines."""

from __future__ import annotations

import threading
import time
from typing import Any

from limits.storage import Storage

from webapp.errors import StorageError
from webapp.store.database import Database

ADDRESS, SHARED_ADDRESS = "counting://", "counting-together://"
"""Addresses of the two storages, by which `limits` selects one."""

_TIDY_S = 60.0


class CountingStorage(Storage):
    """Counts in memory by the monotonic clock: if a clock were set back, a full counter would stay full.

    The memory storage of `limits` uses the time of day, and starts a thread for most requests.
    """

    STORAGE_SCHEME = ["counting"]  # noqa: RUF012 - a list in `limits` too

    def __init__(self, uri: str | None = None, wrap_exceptions: bool = False, **options: str) -> None:
        super().__init__(uri, wrap_exceptions=wrap_exceptions, **options)
        self._turn = threading.Lock()
        self._counts: dict[str, tuple[int, float]] = {}
        self._tidy_at = 0.0

    @property
    def base_exceptions(self) -> type[Exception]:
        """Return the type of errors that operations may raise."""
        return ValueError

    def incr(self, key: str, expiry: float, *, amount: int = 1) -> int:  # type: ignore[override]
        """Count a request in a window of `expiry` seconds; returns the number of requests in the window."""
        with self._turn:
            now = time.monotonic()
            if now >= self._tidy_at:
                self._counts = {key: found for key, found in self._counts.items() if found[1] > now}
                self._tidy_at = now + _TIDY_S
            count, end = self._counts.get(key, (0, 0.0))
            if end <= now:
                count, end = 0, now + expiry
            self._counts[key] = (count + amount, end)
            return count + amount

    def get(self, key: str) -> int:
        count, end = self._counts.get(key, (0, 0.0))
        return count if end > time.monotonic() else 0

    def get_expiry(self, key: str) -> float:
        """Return the end of the window, seconds since 1970."""
        _, end = self._counts.get(key, (0, 0.0))
        return time.time() + max(end - time.monotonic(), 0.0)

    def check(self) -> bool:
        return True

    def reset(self) -> int:
        """Delete all counters; returns their number."""
        with self._turn:
            count = len(self._counts)
            self._counts = {}
            return count

    def clear(self, key: str) -> None:
        with self._turn:
            self._counts.pop(key, None)


class SharedCounting(Storage):
    """Counts in the database, for all machines together, by the database's clock.

    Args:
        database: Its `request_counts` is not None. While it does not respond, a request that has to be
            counted fails (`DatabaseUnavailable`), as it might exceed the limit. While it is read-only, each
            process counts for itself, so that reading requests still work.
    """

    STORAGE_SCHEME = ["counting-together"]  # noqa: RUF012 - a list in `limits` too

    def __init__(
        self, uri: str | None = None, wrap_exceptions: bool = False, *, database: Database, **options: str
    ) -> None:
        super().__init__(uri, wrap_exceptions=wrap_exceptions, **options)
        assert database.request_counts is not None
        self._database, self._counts = database, database.request_counts
        self._own, self._counts_alone = CountingStorage(), False

    @property
    def base_exceptions(self) -> type[Exception]:
        """Return the type of errors that operations may raise."""
        return StorageError

    def incr(self, key: str, expiry: float, *, amount: int = 1) -> int:  # type: ignore[override]
        """Count a request in a window of `expiry` seconds; returns the number of requests in the window."""
        with self._database.translated_errors():
            hits = self._counts.hit(key, seconds=expiry, amount=amount)
        self._counts_alone = hits is None
        return self._own.incr(key, expiry, amount=amount) if hits is None else hits

    def get(self, key: str) -> int:
        if self._counts_alone:
            return self._own.get(key)
        with self._database.translated_errors():
            return self._counts.count_of(key)[0]

    def get_expiry(self, key: str) -> float:
        """Return the end of the window, seconds since 1970 by the clock of this machine."""
        if self._counts_alone:
            return self._own.get_expiry(key)
        with self._database.translated_errors():
            return time.time() + self._counts.count_of(key)[1]

    def check(self) -> bool:
        try:
            self.get("")
        except StorageError:
            return False
        return True

    def reset(self) -> int:
        """Delete all counters; returns their number."""
        with self._database.translated_errors():
            return self._counts.forget()

    def clear(self, key: str) -> None:
        with self._database.translated_errors():
            self._counts.forget(key)


def storage_address(database: Database) -> tuple[str, dict[str, Any]]:
    """Choose the storage for a library; returns its address and options."""
    if database.request_counts is None:
        return ADDRESS, {}
    return SHARED_ADDRESS, {"database": database}
