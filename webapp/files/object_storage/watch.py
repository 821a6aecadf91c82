"""Reports requests to the object storage, and look-ups in its cache, to a watcher that counts them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

Operation = Literal["get", "put", "delete", "list", "probe"]


class StorageWatcher(Protocol):
    """Counts requests and look-ups; called by any thread."""

    def asked(self, operation: Operation, seconds: float, *, failed: bool) -> None:
        """Record a request: for an object, possibly in several parts, or for a page of a listing."""

    def looked_up(self, *, found: bool) -> None:
        """Record a look-up of an object in the cache, and whether it was found."""


_watchers: list[StorageWatcher] = []
"""The watcher of this process, if any."""


def watch(watcher: StorageWatcher | None) -> None:
    """Report to this watcher from now on; None stops reporting."""
    _watchers[:] = [] if watcher is None else [watcher]


@contextmanager
def asking(operation: Operation) -> Iterator[None]:
    """Report the request in the block."""
    begun, failed = time.perf_counter(), True
    try:
        yield
        failed = False
    finally:
        for watcher in _watchers:
            watcher.asked(operation, time.perf_counter() - begun, failed=failed)


def report_look_up(*, found: bool) -> None:
    """Report a look-up in the cache."""
    for watcher in _watchers:
        watcher.looked_up(found=found)
