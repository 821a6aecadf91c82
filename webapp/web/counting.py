"""Counts requests for rate limits: in the memory of a process, or in the database that machines share."""

from __future__ import annotations

import threading
import time
from typing import Any

from limits.storage import Storage

from webapp.errors import StorageError
from webapp.store.database import Database

ADDRESS, SHARED_ADDRESS = "counting://", "counting-together://"
"""Of the two storages, for those who choose one by its address."""

_TIDY_S = 60.0


class CountingStorage(Storage):
    """Counts by a clock that cannot be set: one that is set back would keep a full counter full.

    The memory storage of `limits` goes by the time of day, and starts a thread at most requests.
    """

    STORAGE_SCHEME = ["counting"]  # noqa: RUF012 - a list in `limits` too

    def __init__(self, uri: str | None = None, wrap_exceptions: bool = False, **options: str) -> None:
        super().__init__(uri, wrap_exceptions=wrap_exceptions, **options)
        self._turn = threading.Lock()
        self._counts: dict[str, tuple[int, float]] = {}
        self._tidy_at = 0.0

    @property
    def base_exceptions(self) -> type[Exception]:
        """Return what an operation may raise."""
        return ValueError

    def incr(self, key: str, expiry: float, *, amount: int = 1) -> int:  # type: ignore[override]
        """Count a request in a window of so many seconds; returns how many there were in it."""
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
        """Return how many requests were counted in the window."""
        count, end = self._counts.get(key, (0, 0.0))
        return count if end > time.monotonic() else 0

    def get_expiry(self, key: str) -> float:
        """Return when the window ends, seconds since 1970."""
        _, end = self._counts.get(key, (0, 0.0))
        return time.time() + max(end - time.monotonic(), 0.0)

    def check(self) -> bool:
        """Return whether it works."""
        return True

    def reset(self) -> int:
        """Forget all counts; returns how many there were."""
        with self._turn:
            count = len(self._counts)
            self._counts = {}
            return count

    def clear(self, key: str) -> None:
        """Forget a count."""
        with self._turn:
            self._counts.pop(key, None)


class SharedCounting(Storage):
    """Counts in the database, where all machines count together, by its clock.

    Parameters
    ----------
    database : Database
        Of which `request_counts` is not None. While it does not answer, a request that has to be counted is
        refused as any other (`DatabaseUnavailable`): one that was let through might be one too many. While it
        is read-only, each process counts for itself, so that reading goes on.
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
        """Return what an operation may raise."""
        return StorageError

    def incr(self, key: str, expiry: float, *, amount: int = 1) -> int:  # type: ignore[override]
        """Count a request in a window of so many seconds; returns how many there were in it."""
        with self._database.translated_errors():
            hits = self._counts.hit(key, seconds=expiry, amount=amount)
        self._counts_alone = hits is None
        return self._own.incr(key, expiry, amount=amount) if hits is None else hits

    def get(self, key: str) -> int:
        """Return how many requests were counted in the window."""
        if self._counts_alone:
            return self._own.get(key)
        with self._database.translated_errors():
            return self._counts.look(key)[0]

    def get_expiry(self, key: str) -> float:
        """Return when the window ends, seconds since 1970 by the clock of this machine."""
        if self._counts_alone:
            return self._own.get_expiry(key)
        with self._database.translated_errors():
            return time.time() + self._counts.look(key)[1]

    def check(self) -> bool:
        """Return whether the database answers."""
        try:
            self.get("")
        except StorageError:
            return False
        return True

    def reset(self) -> int:
        """Forget all counts; returns how many there were."""
        with self._database.translated_errors():
            return self._counts.forget()

    def clear(self, key: str) -> None:
        """Forget a count."""
        with self._database.translated_errors():
            self._counts.forget(key)


def storage_address(database: Database) -> tuple[str, dict[str, Any]]:
    """Choose a storage for a library; gives its address and its options."""
    if database.request_counts is None:
        return ADDRESS, {}
    return SHARED_ADDRESS, {"database": database}
