"""Counts requests for rate limits, in the memory of a process and by one thread at a time."""

from __future__ import annotations

import threading
from typing import Any

from limits.storage import MemoryStorage

ADDRESS = "counting://"
"""Of the storage, for those who choose one by its address."""


class CountingStorage(MemoryStorage):
    """The storage of `limits`, which alone lets two threads start one timer: an error for the second."""

    STORAGE_SCHEME = ["counting"]  # noqa: RUF012 - a list in `limits` too

    def __init__(self, uri: str | None = None, wrap_exceptions: bool = False, **options: str) -> None:
        self._turn = threading.Lock()
        super().__init__(uri, wrap_exceptions=wrap_exceptions, **options)

    def incr(self, *arguments: Any, **options: Any) -> int:
        """Count a request, as `MemoryStorage` does; returns how many there were."""
        with self._turn:
            return super().incr(*arguments, **options)
