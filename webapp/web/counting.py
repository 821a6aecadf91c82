"""Counts requests for rate limits, in the memory of a process."""

from __future__ import annotations

import threading
import time

from limits.storage import Storage

ADDRESS = "counting://"
"""Of the storage, for those who choose one by its address."""

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
