"""Reports requests to the object storage, and looks into its cache, to who counts them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

Operation = Literal["get", "put", "delete", "list", "probe"]


class StorageWatcher(Protocol):
    """Counts requests and looks; called by any thread."""

    def asked(self, operation: Operation, seconds: float, *, failed: bool) -> None:
        """Take note of a request: of an object, which may go in pieces, or of a page of a list."""

    def looked(self, *, found: bool) -> None:
        """Take note of a look for an object in the cache, and whether it was there."""


_watchers: list[StorageWatcher] = []
"""Of this process; one at most."""


def watch(watcher: StorageWatcher | None) -> None:
    """Report to this watcher from now on; None: to none."""
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


def report_look(*, found: bool) -> None:
    """Report a look into the cache."""
    for watcher in _watchers:
        watcher.looked(found=found)
